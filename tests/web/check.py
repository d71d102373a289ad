"""Opens exported web pages in Chromium, moves their lights with a mouse, and compares their pictures with rekindle's own.

    python tests/web/check.py [SOLUTION…]

Without a solution it takes the demo's. It needs a built target/release/rekindle (or its path in REKINDLE), Chromium (or its path in
CHROMIUM), and `pip install numpy OpenEXR Pillow playwright`. WebGL runs in software, so that any machine will do.

Every page is opened from its file without a network. What is compared, in display values before the page's grey, in dB: the
first view under the captured light, as sRGB and under AgX; a light dragged by its handle; one muted, dimmed and coloured in the
panel. The expected pictures are `rekindle render`'s for the same camera and the edits that come to the same. The script fails where one comes out
below its target, where the page says an error, asks for anything beyond its file, or a setup shows the wrong light. Screenshots
are left in the folder web-check.
"""

import base64
import io
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image
from playwright.sync_api import sync_playwright

REPOSITORY = Path(__file__).resolve().parents[2]
REKINDLE = Path(os.environ.get("REKINDLE", REPOSITORY / "target/release/rekindle"))
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
SHOTS = Path("web-check")
# dB of captured light and of edited light, whose shadows are the page's own.
CAPTURED, EDITED = 35.0, 30.0
# Pages leave out what a dielectric mirrors of itself.
WITHOUT_MIRRORS = 28.0
STAGE = 18 / 255
# Radius of the handles' sphere in radii of the object.
REACH = 1.3


def rekindle(*arguments):
    subprocess.run([REKINDLE, *map(str, arguments), "--quiet"], check=True)


def agx(linear):
    """AgX as src/view_transform.rs states it, by another hand: display values, sRGB-encoded."""
    to_2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0113], [0.0164, 0.0880, 0.8956]])
    from_2020 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    inset = np.array([
        [0.856627153315983, 0.0951212405381588, 0.0482516061458583],
        [0.137318972929847, 0.761241990602591, 0.101439036467562],
        [0.11189821299995, 0.0767994186031903, 0.811302368396859],
    ])
    outset = np.array([
        [1.1271005818144368, -0.11060664309660323, -0.016493938717834573],
        [-0.1413297634984383, 1.157823702216272, -0.016493938717834257],
        [-0.14132976349843826, -0.11060664309660294, 1.2519364065950405],
    ])
    stops = np.log2(np.maximum(linear @ to_2020.T @ inset.T, 1e-10))
    x = np.clip((stops + 12.47393) / (4.026069 + 12.47393), 0, 1)
    curve = 15.5 * x**6 - 40.14 * x**5 + 31.96 * x**4 - 6.868 * x**3 + 0.4298 * x**2 + 0.1191 * x - 0.00232
    return srgb((np.maximum(curve @ outset.T, 0) ** 2.2) @ from_2020.T)


def srgb(linear):
    """Display values, cut at white."""
    shown = np.clip(linear, 0, 1)
    return np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)


def read_exr(path, names):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels.astype(np.float64) for name in names], axis=-1)


def white(solution):
    """Radiance that is shown as white, as the program takes it: 1.3 times what 98 % of the known texels stay below."""
    means = read_exr(solution / "diffuse.exr", "RGB").mean(axis=-1)
    known = read_exr(solution / "confidence.exr", "Y")[..., 0] > 0.1
    sorted_means = np.sort(means[known].astype(np.float32))
    return 1.3 * sorted_means[(len(sorted_means) - 1) * 98 // 100]


def reference(solution, camera, edits, folder, transform=srgb):
    """The program's picture with the page's background, and what the object covers."""
    frame = {"file_path": "view.png", "transform_matrix": camera["transform_matrix"]}
    rest = {k: v for k, v in camera.items() if k != "transform_matrix"}
    (folder / "camera.json").write_text(json.dumps({"camera_model": "PINHOLE", **rest, "frames": [frame]}))
    (folder / "edits.json").write_text(json.dumps(edits))
    output = folder / "reference"
    rekindle("render", solution, "--cameras", folder / "camera.json", "--edits", folder / "edits.json", "-o", output)
    pixels = read_exr(output / "view.exr", "RGBA")
    alpha = np.clip(pixels[..., 3:], 0, 1)
    shown = transform(pixels[..., :3] / np.maximum(alpha, 1e-6) / white(solution))
    return STAGE * (1 - alpha) + shown * alpha, alpha[..., 0] > 0


def decibels(a, b, where):
    """Over the pixels that the object covers: background is equal in any case."""
    return -10 * np.log10(np.mean((a[where] - b[where]) ** 2))


class Page:
    """A page in the browser."""

    def __init__(self, browser, path):
        self.page = browser.new_page(viewport={"width": 752, "height": 480})
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.resolve().as_uri())
        self.page.wait_for_function("window.rekindle || document.getElementById('message').textContent !== 'Unpacking…'")
        message = self.page.text_content("#message")
        assert message == "", f"{path}: {message}"

    def picture(self):
        """The settled picture's display values."""
        self.page.wait_for_timeout(100)
        self.page.wait_for_function("rekindle.isSettled()", timeout=300_000)
        data = self.page.evaluate("document.getElementById('picture').toDataURL()")
        image = Image.open(io.BytesIO(base64.b64decode(data.split(",")[1]))).convert("RGB")
        return np.asarray(image) / 255.0

    def camera(self):
        return self.page.evaluate("rekindle.camera()")

    def handle(self, name):
        box = self.page.get_by_label(f"{name} handle", exact=True).bounding_box()
        return np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])

    def drag(self, start, end):
        mouse = self.page.mouse
        mouse.move(*start)
        mouse.down()
        for part in (0.25, 0.5, 0.75, 1.0):
            mouse.move(*(start + part * (end - start)))
        mouse.up()
        # Marks are placed with the picture.
        self.picture()

    def direction(self, at, solution_centre, radius):
        """Direction of a light whose handle is at a place of the window, on the near side: the program's own geometry."""
        camera = self.camera()
        box = self.page.locator("#picture").bounding_box()
        pose = np.array(camera["transform_matrix"])
        scale = camera["w"] / box["width"]
        x = ((at[0] - box["x"]) * scale - camera["cx"]) / camera["fl_x"]
        y = ((at[1] - box["y"]) * scale - camera["cy"]) / camera["fl_y"]
        ray = pose[:3, :3] @ np.array([x, -y, -1.0])
        ray /= np.linalg.norm(ray)
        eye = pose[:3, 3] - solution_centre
        along = -eye @ ray
        nearest = eye + along * ray
        room = (REACH * radius) ** 2 - nearest @ nearest
        assert room > 0, "the handle is on the sphere"
        place = nearest - np.sqrt(room) * ray
        return place / np.linalg.norm(place)

    def set(self, name, value):
        """Sets an input as a user's hand does."""
        self.page.locator(name).evaluate(
            "(input, value) => { input.value = value; input.dispatchEvent(new Event('input', { bubbles: true }));"
            " input.dispatchEvent(new Event('change', { bubbles: true })); }", str(value))

    def shoot(self, name):
        SHOTS.mkdir(exist_ok=True)
        self.page.screenshot(path=SHOTS / f"{name}.png")


def box_of(solution):
    places = [line.split()[1:4] for line in (solution / "mesh.obj").read_text().splitlines() if line.startswith("v ")]
    places = np.array(places, dtype=float)
    low, high = places.min(axis=0), places.max(axis=0)
    return (low + high) / 2, np.linalg.norm(high - low) / 2


def check(browser, solution, folder):
    name = solution.parent.name if solution.name == "solution" else solution.name
    results = []

    def compare(what, page, edits, target, transform=agx):
        shown = page.picture()
        expected, where = reference(solution, page.camera(), edits, folder, transform)
        db = decibels(shown, expected, where)
        print(f"{name}: {what}: {db:.1f} dB (target {target:.0f})", flush=True)
        page.shoot(f"{name}_{what.replace(' ', '_')}")
        both = np.hstack([shown, expected, np.clip(0.5 + 4 * (shown - expected), 0, 1)])
        Image.fromarray((255 * both + 0.5).astype(np.uint8)).save(SHOTS / f"{name}_{what.replace(' ', '_')}_compared.png")
        results.append(db >= target)
        return shown

    file = folder / f"{name}.html"
    rekindle("export", solution, "--for", "web", "-o", file)
    print(f"{name}: {file.stat().st_size / 1e6:.2f} MB", flush=True)
    page = Page(browser, file)
    summary = json.loads((solution / "solution.json").read_text())
    mirrors = summary.get("specular_model") in ("beckmann", "ggx")
    targets = [WITHOUT_MIRRORS if mirrors else target for target in (CAPTURED, EDITED)]
    compare("first view", page, [], targets[0], srgb)
    page.set("#transform", 1)
    captured = compare("captured light", page, [], targets[0])
    lights = summary["lights"]
    centre, radius = box_of(solution)
    # The first light whose handle is on the near side and in sight.
    eye = np.array(page.camera()["transform_matrix"])[:3, 3] - centre
    facing = [light for light in lights if (REACH * radius * np.array(light["direction"]) - eye) @ light["direction"] < 0]
    if facing:
        light = facing[0]
        start = page.handle(light["name"])
        end = start + np.array([-60.0, 35.0])
        page.drag(start, end)
        moved = page.handle(light["name"])
        assert np.linalg.norm(moved - end) < 1.5, f"the handle follows the mouse: {moved}, not {end}"
        to = page.direction(moved, centre, radius).tolist()
        edits = [{"move": {"near": light["direction"], "to": to}}]
        shown = compare("a light dragged", page, edits, targets[1])
        assert decibels(shown, captured, captured.max(axis=-1) > 0.1) < 40, "the picture changes with the light"
        assert page.page.get_by_role("radio", name="Setup 1").get_attribute("aria-checked") == "true"
        # Dimmed by a stop, and of another hue at the same luminance.
        page.set("#stops", -1)
        page.set("#colour", "#ff8000")
        own = np.array(light["flux"])
        hue = np.array([1.0, ((128 / 255 + 0.055) / 1.055) ** 2.4, 0.0])
        weights = np.array([0.2126, 0.7152, 0.0722])
        gain = 0.5 * hue * (weights @ own) / (weights @ hue) / own
        compare("dimmed and coloured", page, [{"gain": {"near": light["direction"], "rgb": gain.tolist()}}, *edits], targets[1])
        page.page.get_by_label(f"Mute {light['name']}", exact=True).click()
        compare("muted", page, [{"mute": {"near": light["direction"]}}], targets[1])
        # Back, and back to the captured light.
        page.page.get_by_role("radio", name="Captured light").click()
        assert np.abs(page.picture() - captured).max() < 0.02, "the captured light is as it was"
        page.page.get_by_role("radio", name="Setup 1").click()
        for _ in range(4):
            page.page.keyboard.press("Control+z")
        assert page.page.get_by_role("radio", name="Setup 1").count() == 0, "all of it is undone"
        assert np.abs(page.picture() - captured).max() < 0.02
    # Turned and moved nearer by the mouse.
    box = page.page.locator("#picture").bounding_box()
    middle = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    page.drag(middle, middle + np.array([130.0, 20.0]))
    page.page.mouse.move(*middle)
    page.page.mouse.wheel(0, -200)
    compare("turned", page, [], targets[0])
    page.page.keyboard.press("r")
    assert np.abs(page.picture() - captured).max() < 0.02, "the view is reset"
    page.page.set_viewport_size({"width": 420, "height": 800})
    page.picture()
    page.shoot(f"{name}_small")
    assert page.said == [], page.said
    beyond = [url for url in page.asked if not url.startswith(("file:", "data:", "blob:"))]
    assert beyond == [], f"the page asks for {beyond}"
    page.page.close()
    return all(results)


def check_without_webgl(playwright, page_file):
    """A browser without WebGL 2 is told so."""
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--disable-gpu", "--disable-3d-apis"])
    page = browser.new_page()
    page.goto(page_file.resolve().as_uri())
    page.wait_for_function("document.getElementById('message').textContent.includes('WebGL 2')", timeout=30_000)
    SHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SHOTS / "without_webgl.png")
    browser.close()


def main():
    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as playwright:
        folder = Path(temporary)
        solutions = [Path(argument) for argument in sys.argv[1:]]
        if not solutions:
            subprocess.run([REKINDLE.resolve(), "--quiet"], cwd=folder, check=True)
            solutions = [folder / "rekindle-demo/solution"]
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        passed = [check(browser, solution, folder) for solution in solutions]
        browser.close()
        check_without_webgl(playwright, next(folder.glob("*.html")))
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
