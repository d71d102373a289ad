"""Writes models of every perspective and fisheye camera by COLMAP itself: pip install pycolmap numpy, python make.py.

The poses are those of the demo's cameras; projections.json says where COLMAP projects points to.
"""
import json
import pathlib

import numpy as np
import pycolmap

here = pathlib.Path(__file__).parent
demo = json.loads((here / "../../../assets/demo/transforms.json").read_text())
f, cx, cy = 611.5, 310.25, 248.75
lenses = {
    "SIMPLE_PINHOLE": [f, cx, cy],
    "PINHOLE": [f, 1.02 * f, cx, cy],
    "SIMPLE_RADIAL": [f, cx, cy, -0.11],
    "RADIAL": [f, cx, cy, -0.12, 0.035],
    "OPENCV": [f, 0.99 * f, cx, cy, -0.13, 0.04, 0.0012, -0.0021],
    "OPENCV_FISHEYE": [f, 1.01 * f, cx, cy, 0.031, -0.012, 0.004, -0.0007],
    "FULL_OPENCV": [f, 0.98 * f, cx, cy, 0.21, -0.09, 0.0011, -0.0017, 0.021, 0.33, -0.05, 0.011],
}

model = pycolmap.Reconstruction()
rng = np.random.default_rng(5)
points = rng.uniform(-0.9, 0.9, (12, 3))
projections = []
for i, (name, params) in enumerate(lenses.items()):
    camera = pycolmap.Camera(camera_id=i + 1, model=name, width=640, height=480, params=params)
    model.add_camera_with_trivial_rig(camera)
    pose = np.array(demo["frames"][i % len(demo["frames"])]["transform_matrix"]) @ np.diag([1, -1, -1, 1.0])
    world_to_camera = np.linalg.inv(pose)
    rigid = pycolmap.Rigid3d(world_to_camera[:3])
    image_name = ["view 0.png", "left/view 1.png"][i % 2].replace("view ", f"{name.lower()} ")
    keypoints = [pycolmap.Point2D(p) for p in rng.uniform(0, 480, ((i % 3) * 2, 2))]
    image = pycolmap.Image(image_id=10 + i, name=image_name, camera_id=i + 1, points2D=keypoints)
    model.add_image_with_trivial_frame(image, rigid)
    in_camera = np.array([rigid * p for p in points])
    for point, at, pixel in zip(points, in_camera, camera.img_from_cam(in_camera)):
        projections.append({"image": image_name, "point": point.tolist(), "pixel": np.asarray(pixel).tolist()})

for kind in ("text", "binary"):
    folder = here / kind
    folder.mkdir(exist_ok=True)
    (model.write_text if kind == "text" else model.write_binary)(str(folder))
(here / "projections.json").write_text(json.dumps({"written_by": f"pycolmap {pycolmap.__version__}", "projections": projections}, indent=1))

# A model of each camera that is refused.
others = {
    "FOV": [f, f, cx, cy, 0.7],
    "SIMPLE_RADIAL_FISHEYE": [f, cx, cy, 0.01],
    "RADIAL_FISHEYE": [f, cx, cy, 0.01, 0.001],
    "THIN_PRISM_FISHEYE": [f, f, cx, cy, 0.01, 0.001, 0.001, 0.001, 0.01, 0.001, 0.001, 0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [f, f, cx, cy] + [0.001] * 12,
    "SIMPLE_DIVISION": [f, cx, cy, -0.01],
    "DIVISION": [f, f, cx, cy, -0.01],
    "SIMPLE_FISHEYE": [f, cx, cy],
    "FISHEYE": [f, f, cx, cy],
    "EUCM": [f, f, cx, cy, 0.5, 1.0],
    "EQUIRECTANGULAR": [640, 480],
}
for name, params in others.items():
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=1, model=name, width=640, height=480, params=params))
    image = pycolmap.Image(image_id=1, name="a.png", camera_id=1)
    model.add_image_with_trivial_frame(image, rigid)
    folder = here / "refused" / name.lower()
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder))
    for extra in ("frames.bin", "rigs.bin", "points3D.bin"):
        (folder / extra).unlink(missing_ok=True)
