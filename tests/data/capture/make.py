"""Writes the small files of this folder by other programs' code: OpenEXR, OpenCV, Pillow, pypng, tifffile and trimesh.

pip install numpy OpenEXR opencv-python-headless pillow pypng tifffile trimesh && python make.py
"""
import cv2
import numpy as np
import OpenEXR
import png
import tifffile
import trimesh
from PIL import Image

W, H = 8, 6
x, y = np.meshgrid(np.arange(W), np.arange(H))
straight = np.stack([(x + 1) / 16, (y + 1) / 16, np.full_like(x, 0.25, float)], -1)
alpha = np.where(x < 6, 1.0, np.where(x == 6, 0.5, 0.0))
rgb = (straight * alpha[..., None]).astype(np.float32)
rgba = np.concatenate([rgb, alpha[..., None]], -1).astype(np.float32)


def exr(name, channels, compression=OpenEXR.ZIP_COMPRESSION, **header):
    header = {"compression": compression, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(header, channels) as file:
        file.write(name)


exr("rgba_half_zip.exr", {"RGBA": rgba.astype(np.float16)})
exr("rgb_float_piz.exr", {"RGB": rgb}, OpenEXR.PIZ_COMPRESSION)
exr("rgba_half_b44.exr", {"RGBA": rgba.astype(np.float16)}, OpenEXR.B44_COMPRESSION)
exr("rgba_half_dwaa.exr", {"RGBA": rgba.astype(np.float16)}, OpenEXR.DWAA_COMPRESSION)
exr(
    "layers.exr",
    {f"ViewLayer.Combined.{c}": rgba[..., i].copy() for i, c in enumerate("RGBA")}
    | {f"ViewLayer.DiffDir.{c}": np.zeros((H, W), np.float32) for c in "RGB"}
    | {"ViewLayer.Depth.Z": np.ones((H, W), np.float32)},
)
# The rightmost column and the bottom row lie outside the data window.
exr(
    "cropped.exr",
    {"RGBA": rgba[1 : H - 1, : W - 1].copy()},
    dataWindow=(np.array([0, 1], np.int32), np.array([W - 2, H - 2], np.int32)),
    displayWindow=(np.array([0, 0], np.int32), np.array([W - 1, H - 1], np.int32)),
)
exr("luminance.exr", {"Y": rgb[..., 0].copy()})
exr("depth.exr", {"Z": rgb[..., 0].copy(), "A": alpha.astype(np.float32)})
parts = [
    OpenEXR.Part({}, {"Z": np.ones((H, W), np.float32)}, "depth"),
    OpenEXR.Part({}, {"RGBA": rgba}, "beauty"),
]
with OpenEXR.File(parts) as file:
    file.write("parts.exr")

cv2.imwrite("radiance.hdr", rgb[..., ::-1])


def encode(v):
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


codes = np.round(255 * encode(straight)).astype(np.uint8)
a8 = np.round(255 * alpha).astype(np.uint8)[..., None]
Image.fromarray(np.concatenate([codes, a8], -1)).save("rgba8.png")
flat = np.full((H, W, 3), 128, np.uint8)
flat[:3] = 255
Image.fromarray(flat).save("rgb8.jpg", quality=95)
a16 = np.round(65535 * np.concatenate([straight, alpha[..., None]], -1)).astype(np.uint16)
with open("rgba16.png", "wb") as file:
    png.Writer(W, H, greyscale=False, alpha=True, bitdepth=16).write(file, a16.reshape(H, -1).tolist())
tifffile.imwrite("rgb16.tif", a16[..., :3], photometric="rgb")
tifffile.imwrite("rgb32f.tif", straight.astype(np.float32), photometric="rgb", compression="zlib")

box = trimesh.creation.box((2, 2, 2))
box.export("box_binary.ply")
box.export("box_ascii.ply", encoding="ascii")
box.export("box.obj", include_normals=True)
