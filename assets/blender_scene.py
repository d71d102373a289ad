"""Rebuilds the captured object with its light in Blender.

In Blender: open this file in the Scripting workspace and press Run, or
    blender --python blender_scene.py
or with the bpy package:
    python blender_scene.py --render PICTURES

It reads scene.json and the files beside it. Below are the choices to change; options of the same names go before them.
"""

import json
import math
import sys
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

# "lamps": every lamp is a light of its own, to be moved and dimmed; "probe": the light is the picture of it, exact;
# "imported": that of the object's file.
LIGHT = "lamps"
# "beckmann": the estimated lobe itself; "principled": what other programs understand. A GGX lobe is the principled one.
MATERIAL = "beckmann"
# Another file in place of scene.json's mesh, with its own material: object.glb or object.usda.
OBJECT = ""

# From +Y up to Blender's +Z up, as its importers do it by default.
UPRIGHT = Matrix(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)))


def option(name, default):
    """The value of a command line option."""
    return sys.argv[sys.argv.index(name) + 1] if name in sys.argv else default


def folder():
    """The folder of this script, also when it is run from Blender's text editor."""
    try:
        return Path(__file__).resolve().parent
    except NameError:
        return Path(bpy.context.space_data.text.filepath).resolve().parent


def image(path, colour_space):
    picture = bpy.data.images.load(str(path))
    picture.colorspace_settings.name = colour_space
    return picture


def linear_space():
    """Blender 4 and 5 call it Linear Rec.709."""
    names = bpy.types.ColorManagedInputColorspaceSettings.bl_rna.properties["name"].enum_items.keys()
    return "Linear Rec.709" if "Linear Rec.709" in names else "Linear"


def add_object(scene, here):
    path = str(here / (OBJECT or scene["mesh"]))
    if path.endswith(".glb"):
        # "Unitless" there: lights are in the units of the colours, not in lux.
        bpy.ops.import_scene.gltf(filepath=path, export_import_convert_lighting_mode="COMPAT")
    elif path.endswith(".usda"):
        bpy.ops.wm.usd_import(filepath=path)
    else:
        bpy.ops.wm.obj_import(filepath=path, forward_axis="NEGATIVE_Z", up_axis="Y")
        obj = bpy.context.selected_objects[0]
        obj.name = scene["name"]
        obj.data.materials.clear()
        obj.data.materials.append(material(scene, here))
    unwanted = {"CAMERA"} if LIGHT == "imported" else {"CAMERA", "LIGHT"}
    for obj in [o for o in bpy.data.objects if o.type in unwanted]:
        bpy.data.objects.remove(obj)


def material(scene, here):
    """The surface: a diffuse part under a lobe."""
    made = bpy.data.materials.new(scene["name"])
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = image(here / scene["base_colour"], linear_space())
    output = nodes.new("ShaderNodeOutputMaterial")
    stated = scene["material"]
    gloss = stated["gloss"]
    if gloss:
        # Parts differ: roughness is in red, the reflectance as a part of the strongest part's in green.
        levels = nodes.new("ShaderNodeTexImage")
        levels.image = image(here / gloss["file"], linear_space())
        channels = nodes.new("ShaderNodeSeparateColor")
        links.new(levels.outputs["Color"], channels.inputs[0])
    tint = None
    if gloss and gloss["colour"]:
        # Parts reflect in different colours, as metals do beside plastic.
        tint = nodes.new("ShaderNodeTexImage")
        tint.image = image(here / gloss["colour"], linear_space())
    f0, ior = (gloss or stated)["f0"], (gloss or stated)["ior"]

    def times_level(target, factor):
        """The level times a factor, a number or a socket, into a socket."""
        product = nodes.new("ShaderNodeMath")
        product.operation = "MULTIPLY"
        links.new(channels.outputs[1], product.inputs[0])
        if isinstance(factor, float):
            product.inputs[1].default_value = factor
        else:
            links.new(factor, product.inputs[1])
        links.new(product.outputs[0], target)

    if MATERIAL == "principled" or stated["specular"] == "ggx":
        shader = nodes.new("ShaderNodeBsdfPrincipled")
        shader.distribution = "GGX"
        shader.inputs["Roughness"].default_value = stated["roughness"]
        shader.inputs["IOR"].default_value = ior
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        if gloss:
            links.new(channels.outputs[0], shader.inputs["Roughness"])
            # At 0.5 the surface reflects what its index of refraction says.
            times_level(shader.inputs["Specular IOR Level"], 0.5)
        if tint:
            links.new(tint.outputs["Color"], shader.inputs["Specular Tint"])
        if stated["specular"] is None:
            shader.inputs["Specular IOR Level"].default_value = 0.0
    else:
        diffuse = nodes.new("ShaderNodeBsdfDiffuse")
        links.new(texture.outputs["Color"], diffuse.inputs["Color"])
        shader = diffuse
        if stated["specular"] is not None:
            glossy = nodes.new("ShaderNodeBsdfAnisotropic")
            glossy.distribution = "GGX" if stated["specular"] == "metal" else "BECKMANN"
            glossy.inputs["Color"].default_value = (1, 1, 1, 1)
            glossy.inputs["Roughness"].default_value = stated["roughness"]
            shader = nodes.new("ShaderNodeMixShader")
            shader.inputs["Fac"].default_value = f0
            if gloss:
                links.new(channels.outputs[0], glossy.inputs["Roughness"])
                if tint:
                    links.new(tint.outputs["Color"], glossy.inputs["Color"])
                times_level(shader.inputs["Fac"], f0)
            links.new(diffuse.outputs[0], shader.inputs[1])
            links.new(glossy.outputs[0], shader.inputs[2])
            if stated["specular"] == "beckmann":
                fresnel = nodes.new("ShaderNodeFresnel")
                fresnel.inputs["IOR"].default_value = ior
                if gloss:
                    times_level(shader.inputs["Fac"], fresnel.outputs[0])
                else:
                    links.new(fresnel.outputs[0], shader.inputs["Fac"])
    links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def add_lamps(scene):
    for lamp in scene["lamps"]:
        direction = UPRIGHT.to_3x3() @ Vector(lamp["direction"])
        if lamp["position"] is None:
            light = bpy.data.lights.new(lamp["name"], "SUN")
            light.angle = math.radians(2 * lamp["angular_radius_deg"])
            light.energy = lamp["irradiance"]
        else:
            light = bpy.data.lights.new(lamp["name"], "POINT")
            light.shadow_soft_size = lamp["distance"] * math.sin(math.radians(lamp["angular_radius_deg"]))
            # A point light of the power P lights a facing surface at the distance d with P/(4 pi^2 d^2) times pi.
            light.energy = lamp["irradiance"] * 4 * math.pi * lamp["distance"] ** 2
        light.color = lamp["colour"]
        obj = bpy.data.objects.new(lamp["name"], light)
        obj.rotation_mode = "QUATERNION"
        # Lights shine along their -Z.
        obj.rotation_quaternion = direction.to_track_quat("Z", "Y")
        obj.location = UPRIGHT @ Vector(lamp["position"]) if lamp["position"] else 3 * direction
        bpy.context.collection.objects.link(obj)


def set_world(scene, here):
    world = bpy.data.worlds.new("Light")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    texture = nodes.new("ShaderNodeTexEnvironment")
    which = scene["light"] if LIGHT == "probe" else scene["light_without_lamps"]
    texture.image = image(here / which, linear_space())
    texture.interpolation = "Closest"
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs[0], output.inputs["Surface"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 4096


def add_cameras(scene):
    cameras = []
    for frame in scene["cameras"]:
        data = bpy.data.cameras.new(frame["file_path"])
        width, height = frame["w"], frame["h"]
        data.sensor_fit = "HORIZONTAL" if width >= height else "VERTICAL"
        sensor = data.sensor_width if width >= height else data.sensor_height
        data.lens = frame["fl_x"] * sensor / max(width, height)
        # Shifts are in parts of the larger side; Blender's picture moves against them.
        data.shift_x = (0.5 * width - frame["cx"]) / max(width, height)
        data.shift_y = (frame["cy"] - 0.5 * height) / max(width, height)
        data.clip_start, data.clip_end = 1e-3, 1e5
        obj = bpy.data.objects.new(frame["file_path"], data)
        obj.matrix_world = UPRIGHT @ Matrix(frame["transform_matrix"])
        bpy.context.collection.objects.link(obj)
        cameras.append((obj, frame))
    return cameras


def set_look(scene):
    """Cycles, a transparent background, and the exposure of rekindle's pictures."""
    settings = bpy.context.scene
    settings.render.engine = "CYCLES"
    settings.render.film_transparent = True
    settings.cycles.use_denoising = False
    settings.cycles.use_adaptive_sampling = False
    settings.cycles.sample_clamp_direct = 0
    settings.cycles.sample_clamp_indirect = 0
    if not scene["interreflections"]:
        # What the surface sends to itself is in the colours already.
        settings.cycles.max_bounces = 0
    settings.view_settings.view_transform = "AgX"
    settings.view_settings.exposure = -math.log2(scene["white"])


def use_camera(camera, frame):
    settings = bpy.context.scene
    settings.camera = camera
    settings.render.resolution_x, settings.render.resolution_y = frame["w"], frame["h"]
    settings.render.resolution_percentage = 100
    ratio = frame["fl_x"] / frame["fl_y"]
    settings.render.pixel_aspect_x, settings.render.pixel_aspect_y = 1.0, ratio


def render(cameras, target):
    settings = bpy.context.scene
    settings.cycles.samples = int(option("--samples", "64"))
    settings.render.image_settings.file_format = "OPEN_EXR"
    settings.render.image_settings.color_depth = "32"
    for camera, frame in cameras:
        use_camera(camera, frame)
        settings.render.filepath = str(Path(target).resolve() / (Path(frame["file_path"]).stem + ".exr"))
        bpy.ops.render.render(write_still=True)


def main():
    here = folder()
    scene = json.loads((here / "scene.json").read_text())
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    # Blender begins with grey light from everywhere, and importers want a world to be there.
    world = bpy.context.scene.world = bpy.data.worlds.new("Dark")
    world.use_nodes = True
    world.node_tree.nodes.clear()
    add_object(scene, here)
    if LIGHT == "lamps":
        add_lamps(scene)
    if LIGHT != "imported":
        set_world(scene, here)
    cameras = add_cameras(scene)
    if cameras:
        use_camera(*cameras[0])
    set_look(scene)
    if "--render" in sys.argv:
        render(cameras, option("--render", "."))


LIGHT = option("--light", LIGHT)
MATERIAL = option("--material", MATERIAL)
OBJECT = option("--object", OBJECT)
main()
