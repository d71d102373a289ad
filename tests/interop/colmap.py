"""Takes the demo's object through COLMAP: its cameras are found from photographs, and what comes out is compared with the demo's own.

    pip install pycolmap numpy OpenEXR pillow
    python tests/interop/colmap.py target/release/rekindle [--out FOLDER]

Photographs the demo's solution from all around, on a printed floor, and lets COLMAP find cameras and lens in a frame and a scale of
its own. A capture is made of that model as COLMAP writes it, the demo's six HDR images and its mesh, which lies elsewhere. `align`
and `solve` must arrive at what the demo's own cameras give. Fails where a number is beyond its bound.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pycolmap
from PIL import Image

DEMO = Path(__file__).resolve().parents[2] / "assets/demo"
# The demo's object stands at the origin on a floor of this height and radius, in its units.
FLOOR, RADIUS = -0.762389, 2.0
# Rings of more cameras: elevation in degrees, number.
RINGS = [(22, 16), (40, 14), (58, 12)]
# Largest errors that pass.
BOUNDS = {
    "cameras not found, of 48": 0,
    "cameras off, median (degrees)": 0.05,
    "mesh turned (degrees)": 0.2,
    "mesh shifted (% of its size)": 0.2,
    "silhouettes amiss, mean (%)": 1.0,
    "σ (%)": 2.0,
    "lamps missed": 0,
    "direction, worst (degrees)": 0.5,
    "flux, worst (%)": 3.0,
}


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    print(done.stderr.strip().replace("\r", "\n"), file=sys.stderr)
    return done.stdout


def read(path):
    """RGBA, premultiplied."""
    channels = OpenEXR.File(str(path)).channels()
    if "RGBA" in channels:
        return channels["RGBA"].pixels.astype(np.float64)
    return np.stack([channels[c].pixels for c in "RGBA"], axis=-1).astype(np.float64)


def all_cameras():
    """The demo's six cameras and those of the rings, which look at the object from as far."""
    cameras = json.loads((DEMO / "transforms.json").read_text())
    distance = np.linalg.norm(np.array(cameras["frames"][0]["transform_matrix"])[:3, 3])
    for elevation, count in RINGS:
        for turn in 2 * np.pi * np.arange(count) / count:
            up = np.radians(elevation)
            back = np.array([np.cos(up) * np.sin(turn), np.sin(up), np.cos(up) * np.cos(turn)])
            right = np.cross([0, 1, 0], back) / np.cos(up)
            pose = np.eye(4)
            pose[:3] = np.stack([right, np.cross(back, right), back, distance * back], axis=-1)
            name = f"images/ring_{elevation}_{round(np.degrees(turn)):03}.exr"
            cameras["frames"].append({"file_path": name, "transform_matrix": pose.tolist()})
    return cameras


def print_of_floor():
    """Noise of several sizes, the finest a few pixels of a photograph wide."""
    random = np.random.default_rng(1)
    side, picture = 2048, 0
    for cells in (16, 32, 64, 128, 256, 512):
        noise = Image.fromarray((255 * random.random((cells, cells))).astype(np.uint8))
        picture = picture + np.asarray(noise.resize((side, side), Image.BICUBIC)) / 255 - 0.5
    return np.clip(0.35 + 0.4 * picture, 0.02, 1.0)


def floor_behind(cameras, pose, floor):
    """The floor as a camera sees it, with nine rays a pixel."""
    steps = (np.arange(3) + 0.5) / 3
    x = (np.arange(cameras["w"])[:, None] + steps).ravel()
    y = (np.arange(cameras["h"])[:, None] + steps).ravel()
    x, y = np.meshgrid((x - cameras["cx"]) / cameras["fl_x"], (cameras["cy"] - y) / cameras["fl_y"])
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    far = (FLOOR - pose[1, 3]) / np.minimum(rays[..., 1], -1e-6)
    at = pose[:3, 3] + far[..., None] * rays
    place = (at[..., ::2] / RADIUS + 1) * (len(floor) - 2) / 2
    inside = np.hypot(at[..., 0], at[..., 2]) < RADIUS
    place = np.where(inside[..., None], place, 0)
    column, row = place[..., 0].astype(int), place[..., 1].astype(int)
    u, v = place[..., 0] - column, place[..., 1] - row
    seen = (1 - v) * ((1 - u) * floor[row, column] + u * floor[row, column + 1])
    seen += v * ((1 - u) * floor[row + 1, column] + u * floor[row + 1, column + 1])
    seen = np.where(inside, seen, 0.1)
    return seen.reshape(cameras["h"], 3, cameras["w"], 3).mean(axis=(1, 3))


def take_photographs(cameras, pictures, target):
    """8-bit photographs of the object on its floor."""
    target.mkdir(exist_ok=True)
    floor = print_of_floor()
    for frame in cameras["frames"]:
        name = Path(frame["file_path"]).stem
        object_ = read(pictures / f"{name}.exr")
        white = np.percentile(object_[object_[..., 3] > 0.5][:, :3], 99)
        behind = floor_behind(cameras, np.array(frame["transform_matrix"]), floor)
        linear = object_[..., :3] / white + (1 - object_[..., 3:]) * behind[..., None]
        linear = np.clip(linear, 0, 1)
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        Image.fromarray(np.round(255 * srgb).astype(np.uint8)).save(target / f"{name}.png")


def find_cameras(photographs, folder):
    """COLMAP's largest model, by its defaults with one lens for all."""
    folder.mkdir()
    pycolmap.set_random_seed(0)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.WARNING.value
    database = folder / "database.db"
    pycolmap.extract_features(database, photographs, camera_mode=pycolmap.CameraMode.SINGLE)
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, photographs, folder / "sparse")
    if not models:
        sys.exit("COLMAP found no model")
    return max(models.values(), key=lambda model: model.num_reg_images())


def similarity(source, target):
    """Scale, rotation and shift that bring points to others, after Umeyama."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = (s * sign).sum() / (a**2).sum()
    return scale, rotation, target.mean(axis=0) - scale * rotation @ source.mean(axis=0)


def angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))


def turn(rotation):
    return np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def compare_cameras(cameras, model, errors):
    """Where COLMAP's cameras are; returns what brings the demo's frame into its frame."""
    stated = {Path(f["file_path"]).stem: np.array(f["transform_matrix"])[:3, 3] for f in cameras["frames"]}
    found = {Path(i.name).stem: i.projection_center() for i in model.images.values() if i.has_pose}
    names = sorted(found)
    places, centres = (np.array([d[n] for n in names]) for d in (stated, found))
    scale, rotation, shift = similarity(places, centres)
    off = np.linalg.norm((centres - shift) @ rotation / scale - places, axis=1)
    distance = np.linalg.norm(places, axis=1)
    errors["cameras not found, of 48"] = len(stated) - len(names)
    errors["cameras off, median (degrees)"] = np.degrees(np.median(off / distance))
    return scale, rotation, shift


def compare_mesh(aligned, true, errors):
    scale, rotation, shift = true
    matrix = np.array(aligned["mesh_transform"])
    errors["mesh turned (degrees)"] = turn(rotation.T @ matrix[:3, :3] / aligned["scale"])
    size = 2 * scale * np.linalg.norm([0.421945, 0.762389, 0.777308])
    errors["mesh shifted (% of its size)"] = 100 * np.linalg.norm(matrix[:3, 3] - shift) / size
    errors["silhouettes amiss, mean (%)"] = 100 * (1 - aligned["overlap"])


def compare_light(reference, solution, rotation, errors):
    """Each of the demo's lamps with the nearest one found."""
    errors["σ (%)"] = 100 * abs(solution["sigma"] / reference["sigma"] - 1)
    lamps = solution["lights"]
    errors["lamps missed"] = abs(len(lamps) - len(reference["lights"]))
    directions, fluxes = [], []
    for lamp in reference["lights"]:
        expected = rotation @ lamp["direction"]
        nearest = min(lamps, key=lambda other: angle(expected, other["direction"]))
        directions.append(angle(expected, nearest["direction"]))
        fluxes.append(100 * abs(np.sum(nearest["flux"]) / np.sum(lamp["flux"]) - 1))
    errors["direction, worst (degrees)"] = max(directions)
    errors["flux, worst (%)"] = max(fluxes)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rekindle", type=lambda path: Path(path).resolve())
    parser.add_argument("--out", type=Path, default=Path("interop-colmap"), help="folder, made anew")
    args = parser.parse_args()
    out = args.out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    reference, capture, solution = out / "reference", out / "capture", out / "solution"

    run(args.rekindle, "solve", DEMO, "-o", reference, "--quiet")
    cameras = all_cameras()
    (out / "cameras.json").write_text(json.dumps(cameras))
    run(args.rekindle, "render", reference, "--cameras", out / "cameras.json", "-o", out / "pictures", "--quiet")
    take_photographs(cameras, out / "pictures", out / "photographs")
    model = find_cameras(out / "photographs", out / "colmap")

    shutil.copytree(DEMO / "images", capture / "images")
    shutil.copy(DEMO / "mesh.obj", capture)
    (capture / "sparse/0").mkdir(parents=True)
    model.write(capture / "sparse/0")
    aligned = json.loads(run(args.rekindle, "align", capture, "-o", capture / "mesh.obj", "--json"))
    run(args.rekindle, "solve", capture, "-o", solution, "--quiet")

    errors = {}
    true = compare_cameras(cameras, model, errors)
    compare_mesh(aligned, true, errors)
    expected, found = (json.loads((f / "solution.json").read_text()) for f in (reference, solution))
    compare_light(expected, found, true[1], errors)
    for name, bound in BOUNDS.items():
        print(f"{name:34} {errors[name]:8.3f}, at most {bound:g} wanted")
    sys.exit(any(not errors[name] <= bound for name, bound in BOUNDS.items()))


if __name__ == "__main__":
    main()
