"""Loads what rekindle exports in the real programs and compares their pictures with rekindle's own.

    pip install bpy mitsuba numpy OpenEXR
    python tests/interop/check.py target/release/rekindle CAPTURE [--out FOLDER] [--size 240] [--samples 256]

Solves the capture, exports it, renders its input views in rekindle, in Blender (Cycles, on the processor) and in Mitsuba 3, and
prints a table of PSNR: sRGB-encoded, white at the 99.5th percentile, over the pixels that the object covers. Fails where a
program comes out below its target. The light's map is left out for near lamps, which no map can show.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR

# Least PSNR in dB of the worst view.
TARGETS = {
    "Mitsuba, Beckmann": 35.0,
    "Blender, Beckmann, lamps": 28.0,
    "Blender, Beckmann, probe": 28.0,
    "Blender, Principled (GGX), lamps": 28.0,
    "Blender, glTF with its lamps": 28.0,
    "Blender, USD with its light": 28.0,
}


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return done.stdout


def read(path):
    """RGBA as float64."""
    channels = OpenEXR.File(str(path)).channels()
    if "RGBA" in channels:
        return channels["RGBA"].pixels.astype(np.float64)
    return np.stack([channels[c].pixels for c in "RGBA"], axis=-1).astype(np.float64)


def encoded(linear):
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def psnr(reference, picture):
    inside = (reference[..., 3] > 0.999) & (picture[..., 3] > 0.999)
    a, b = reference[inside][:, :3], picture[inside][:, :3]
    white = np.percentile(a.mean(axis=-1), 99.5)
    return -10 * np.log10(np.mean((encoded(a / white) - encoded(b / white)) ** 2))


def small_cameras(path, target, size):
    """The cameras with pictures `size` pixels wide."""
    cameras = json.loads(path.read_text())
    for frame in cameras["frames"]:
        factor = size / frame["w"]
        frame["h"] = round(frame["h"] * factor)
        frame["w"] = size
        for key in ("fl_x", "fl_y", "cx", "cy"):
            frame[key] *= factor
    target.write_text(json.dumps(cameras))


MITSUBA = """
import sys
import mitsuba as mi
mi.set_variant("scalar_rgb")
folder, samples, target = sys.argv[1], int(sys.argv[2]), sys.argv[3]
scene = mi.load_file(folder + "/mitsuba.xml", spp=samples)
for index, sensor in enumerate(scene.sensors()):
    picture = mi.render(scene, sensor=sensor, seed=index)
    mi.Bitmap(picture).write(f"{target}/{sensor.id().split('/')[-1].rsplit('_', 1)[0]}.exr")
"""


def compare(name, reference, folder, report):
    values = [
        psnr(read(path), read(folder / path.name)) for path in sorted(reference.glob("*.exr"))
    ]
    report.append((name, values))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rekindle", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--out", type=Path, default=Path("interop"))
    parser.add_argument("--size", type=int, default=240, help="columns of the pictures")
    parser.add_argument("--samples", type=int, default=256, help="samples per pixel")
    parser.add_argument("--map", type=int, default=1024, help="columns of the light's map")
    args = parser.parse_args()
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    solution, exported, reference = out / "solution", out / "export", out / "rekindle"
    run(args.rekindle, "solve", args.capture, "-o", solution, "--quiet")
    small_cameras(solution / "cameras.json", out / "cameras.json", args.size)
    run(args.rekindle, "export", solution, "-o", exported, "--cameras", out / "cameras.json",
        "--size", args.map, "--quiet")
    run(args.rekindle, "render", solution, "-o", reference, "--cameras", out / "cameras.json", "--quiet")

    near = json.loads((exported / "lights.json").read_text())["radius"] is not None
    report = []
    folder = out / "mitsuba"
    folder.mkdir(exist_ok=True)
    run(sys.executable, "-c", MITSUBA, exported, args.samples, folder)
    compare("Mitsuba, Beckmann", reference, folder, report)
    for name, options in {
        "Blender, Beckmann, lamps": ["--light", "lamps", "--material", "beckmann"],
        "Blender, Beckmann, probe": ["--light", "probe", "--material", "beckmann"],
        "Blender, Principled (GGX), lamps": ["--light", "lamps", "--material", "principled"],
        "Blender, glTF with its lamps": ["--light", "imported", "--object", "object.glb"],
        "Blender, USD with its light": ["--light", "imported", "--object", "object.usda"],
    }.items():
        if near and "probe" in name:
            continue
        folder = out / name.lower().replace(", ", "_").replace(" ", "_")
        run(sys.executable, exported / "blender_scene.py", "--render", folder,
            "--samples", args.samples, *options)
        compare(name, reference, folder, report)

    failed = False
    for name, values in report:
        target = TARGETS[name]
        failed |= min(values) < target
        print(f"{name:34} {min(values):5.1f} to {max(values):5.1f} dB, at least {target:.0f} wanted")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
