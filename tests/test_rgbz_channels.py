"""Which channels are taken for colour and depth, by what renderers write."""

from __future__ import annotations

import pytest

from fewrays import SampleError
from fewrays.io.rgbz_channels import find_color, find_depth


def layer(name: str, components: str = "RGBA") -> list[str]:
    return [f"{name}.{c}" if name else c for c in components]


BLENDER = [*layer("ViewLayer.Combined"), "ViewLayer.Depth.Z", *layer("ViewLayer.Normal", "XYZ")]
FILES = {
    "single layer": ([*layer(""), "Z"], "R", "Z"),
    "Blender": (BLENDER, "ViewLayer.Combined.R", "ViewLayer.Depth.Z"),
    "Blender 5": (
        [*layer("ViewLayer.Combined"), "ViewLayer.Depth.V", "ViewLayer.Denoising Depth.V"],
        "ViewLayer.Combined.R",
        "ViewLayer.Depth.V",
    ),
    "Mitsuba": ([*layer(""), *layer("img"), *layer("pos", "XYZ"), "dd.y.T"], "R", "dd.y.T"),
    "pbrt": (
        [*layer("", "RGB"), *layer("Albedo", "RGB"), *layer("P", "XYZ"), *layer("N", "XYZ"), "dzdx"],
        "R",
        "P.Z",
    ),
    "Arnold": ([*layer(""), *layer("diffuse", "RGB"), "Z", *layer("N", "XYZ")], "R", "Z"),
    "Unreal": (
        [
            *layer("ActorHitProxyMask00"),
            *layer("FinalImageMovieRenderQueue_Beauty"),
            *layer("FinalImageMovieRenderQueue_WorldDepth", "BGR"),
            *layer("FinalImageMovieRenderQueue_MotionVectors", "BGR"),
        ],
        "FinalImageMovieRenderQueue_Beauty.R",
        "FinalImageMovieRenderQueue_WorldDepth.R",
    ),
    "Nuke": ([f"rgba.{c}" for c in ("red", "green", "blue", "alpha")] + ["depth.Z"], "rgba.red", "depth.Z"),
    "Mantra": ([*layer("C", "RGBA"), "Pz"], "C.R", "Pz"),
    "V-Ray": ([*layer(""), *layer("VRayZDepth", "R"), *layer("VRayNormals", "XYZ")], "R", "VRayZDepth.R"),
}


@pytest.mark.parametrize("writer", FILES)
def test_what_renderers_write_is_found(writer: str) -> None:
    names, red, depth = FILES[writer]
    found = find_depth(names)
    assert found.name == depth
    assert found.kind == ("distance" if writer == "Mitsuba" else "planar")
    color = find_color(names, beside=found.name)
    assert color.rgb[0] == red
    assert len(set(color.rgb)) == 3
    alpha = [name for name in names if name.rpartition(".")[2].lower() in ("a", "alpha")]
    same_layer = [name for name in alpha if name.rpartition(".")[0] == red.rpartition(".")[0]]
    assert color.alpha == (same_layer[0] if same_layer else None)


def test_normals_are_not_depth() -> None:
    names = [*layer(""), *layer("N", "XYZ"), *layer("ViewLayer.Position", "XYZ")]
    with pytest.raises(SampleError, match=r"no channel has a name known for depth.*ViewLayer\.Position\.Z"):
        find_depth(names)
    assert find_depth(names, "viewlayer.position.z").name == "ViewLayer.Position.Z"


def test_two_view_layers_leave_the_choice_to_the_user() -> None:
    names = [*BLENDER, *(name.replace("ViewLayer", "Second") for name in BLENDER)]
    with pytest.raises(
        SampleError, match=r"ViewLayer\.Depth\.Z, Second\.Depth\.Z; choose one by depth_channel"
    ):
        find_depth(names)
    chosen = find_depth(names, "Second.Depth.Z")
    assert find_color(names, beside=chosen.name).rgb[0] == "Second.Combined.R"
    with pytest.raises(SampleError, match="choose one by color_layer"):
        find_color(names)
    assert find_color(names, "second.combined").alpha == "Second.Combined.A"


def test_unknown_names_are_listed() -> None:
    with pytest.raises(SampleError, match="the file has R, G, B"):
        find_depth(layer("", "RGB"))
    with pytest.raises(SampleError, match=r"layer 'wall': has no red"):
        find_color(layer(""), "wall")
    with pytest.raises(SampleError, match="no layer has a name known"):
        find_color([*layer("foo"), *layer("bar")])


def test_a_grey_picture_has_three_equal_channels() -> None:
    assert find_color(["Y", "Z"]).rgb == ("Y", "Y", "Y")
