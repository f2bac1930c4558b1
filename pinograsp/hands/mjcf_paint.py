"""Colours and textures of what is seen in an MJCF file."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from pinograsp.hands.elements import written
from pinograsp.hands.mjcf_source import Source

_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")


class Paint:
    """The materials and textures of an MJCF file."""

    def __init__(self, source: Source):
        self.source = source
        assets = {
            tag: {one.get("name", ""): one for one in source.element.findall(f"asset/{tag}")}
            for tag in ("material", "texture")
        }
        self.materials, self.textures = assets["material"], assets["texture"]

    def put_on(self, visual: ElementTree.Element, given: dict[str, str]) -> None:
        """Give a geom that is seen its own colour or that of its material, and the material's texture.

        Patterns that MuJoCo makes itself become their mean colour. ``given``: the geom's attributes.
        """
        element = self.materials.get(given.get("material", ""))
        material = {} if element is None else self.source.attributes(element)
        rgba = given.get("rgba", material.get("rgba"))
        name = material.get("texture") or self._layer(element)
        texture = self.textures.get(name)
        file = "" if texture is None else next((texture.get(key, "") for key in _FILES if texture.get(key)), "")
        if texture is not None and not file:
            rgba = self._mean(texture, rgba)
        if rgba or file:
            paint = ElementTree.SubElement(visual, "material")
            if rgba:
                ElementTree.SubElement(paint, "color", rgba=rgba)
            if file:
                ElementTree.SubElement(paint, "texture", filename=str(self.source.asset(file, "texturedir")))

    def _layer(self, material: ElementTree.Element | None) -> str:
        """The texture of a material's colours, where it has one for each of several roles."""
        layers = [] if material is None else material.findall("layer")
        return next((one.get("texture", "") for one in layers if one.get("role") in ("rgb", "rgba")), "")

    def _mean(self, texture: ElementTree.Element, rgba: str | None) -> str:
        """The mean colour of a pattern, times a colour."""
        given = {"name": texture.get("name", ""), **texture.attrib}
        first = self.source.numbers(given, "rgb1", "0.8 0.8 0.8", 3)
        second = first if given.get("builtin") == "flat" else self.source.numbers(given, "rgb2", "0.5 0.5 0.5", 3)
        factor = self.source.numbers({"rgba": rgba} if rgba else {}, "rgba", "1 1 1 1", 4)
        return written(factor * np.append((first + second) / 2, 1.0))
