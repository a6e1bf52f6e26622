"""A MuJoCo model with all of its files, as they can be copied: included files are part of the text, assets beside it.

The files are read as XML, so that a model which would take all memory, or never end, is refused before MuJoCo reads it,
as is one that names files of somebody else: only what lies with the model belongs to it.
"""

import os
from collections.abc import Callable, Iterator
from math import prod
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import GIT_LFS, NOT_FETCHED, open_regular, read_bounded_text

_MOST_ELEMENTS: Final = 50_000
"""Largest number of elements; what is repeated, or in a composite, counts as often as it is made."""

DEEPEST_MODEL: Final = 200  # Largest depth of elements within each other, and of files that include each other
_MOST_POINTS: Final = 2**26  # Largest number of points of height fields and of pixels of textures

_REPEATED: Final = ("replicate", "composite", "flexcomp")
"""Elements that make as many others as their attribute `count` says."""

_POINTS: Final = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
"""Attributes whose product is the number of points of an element."""

_REMEDY: Final = "more than this is not read; make it smaller"


def check_model_size(root: ET.Element, path: Path) -> None:
    """Ensures that a model has no more elements and points than a robot.

    Args:
        root: The model without includes.
        path: Its file, for messages.

    Raises:
        InputError: It has more; the message names the element.
    """
    waiting = [(root, 1, 0)]
    elements = 0
    points = 0
    while waiting:
        element, times, depth = waiting.pop()
        if element.tag in _REPEATED:
            times *= _product(element, ("count",))
        elements += times
        points += times * _product(element, _POINTS.get(str(element.tag), ()), none=0)
        where = f"{path}: {_begin(element)}"
        if depth > DEEPEST_MODEL:
            raise InputError(f"{where}: nested more than {DEEPEST_MODEL} deep; {_REMEDY}")
        if elements > _MOST_ELEMENTS:
            raise InputError(
                f"{where}: with it the model has {elements} elements, of at most {_MOST_ELEMENTS}; {_REMEDY}"
            )
        if points > _MOST_POINTS:
            raise InputError(f"{where}: with it the model has {points} points, of at most {_MOST_POINTS}; {_REMEDY}")
        waiting.extend((child, times, depth + 1) for child in element)


def _product(element: ET.Element, keys: tuple[str, ...], none: int = 1) -> int:
    """Product of all numbers of these attributes; `none` if there is none, or one that is no number."""
    numbers = [word for key in keys for word in element.get(key, "").split()]
    try:
        return prod(max(1, int(float(word))) for word in numbers) if numbers else none
    except (OverflowError, ValueError):
        return none


def _begin(element: ET.Element) -> str:
    """The tag of an element as in the file, shortened."""
    attributes = "".join(f' {key}="{value}"' for key, value in element.items())
    return f"<{element.tag}{attributes:.80}>"


LARGEST_XML: Final = 2**24  # Largest total size of the XML files that are read [bytes]
LARGEST_ASSETS: Final = 2**30  # Largest total size of the assets that are copied [bytes]
MOST_FILES: Final = 10_000  # Largest number of included files and assets
MODEL_FILE: Final = "model.xml"  # Name of the copied model
ASSETS: Final = "assets"  # Name of the folder of its assets
_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")  # Attributes of `compiler` that name folders of assets

NAMED_BY_FILE: Final = ("mesh", "hfield", "texture")
"""Assets that have the name of their file, where they are given no other one."""

_PACKAGE: Final = "package://"  # Begins the path of a file in a URDF that is given by the package which has it

_MANIFEST: Final = "package.xml"  # File of a ROS package, all of which belongs to the models in it

_BESIDE: Final = ("assets", "materials", "mesh", "meshes", "textures")
"""Folders beside that of a model, such as `urdf`, which belong to the model, too."""

_HINT: Final = "give a MuJoCo model (MJCF) or a URDF"


def model_files(path: Path) -> dict[str, str | Path]:
    """All files of a model: by their paths in a new folder, the text or the file that is copied.

    Args:
        path: MJCF, or URDF without macros.

    Raises:
        InputError: A file is missing or is no XML, it does not lie with the model, or the model is too large.
    """
    copies = _Copies(path)
    copies.files[MODEL_FILE] = copies.text_of(path, f"{ASSETS}/")
    return copies.files


class _Copies:
    """The files that are copied; they have different names in one folder."""

    def __init__(self, main: Path):
        self.main = main
        self.files = dict[str, str | Path]()
        self._own = _own_folders(main)
        self._read = 0
        self._bytes = 0
        self._letters = 0
        self._names: dict[Path, str] = {}

    def text_of(self, path: Path, before: str) -> str:
        """XML of a model with its includes, in which its assets are named as in the new folder.

        Args:
            before: What precedes the names of assets.
        """
        places: dict[ET.Element, Path] = {}
        root = self._expanded(path, path.parent, (), places)
        check_model_size(root, path)
        compilers = list(root.iter("compiler"))
        folders = [text for compiler in compilers for key in _FOLDERS if (text := compiler.attrib.pop(key, ""))]
        for compiler in compilers:
            compiler.attrib.pop("strippath", "")
        urdf = root.tag == "robot"
        if urdf:
            _discard_visuals(root, lambda value: self._own_file(value, [path.parent], folders))
        for element in root.iter():
            for key in [key for key in element.attrib if key.startswith("file")]:
                if value := element.attrib[key].strip():
                    source = self._source(value, [path.parent, places[element]], folders, element, key)
                    if element.tag in NAMED_BY_FILE and not urdf:
                        element.attrib.setdefault("name", source.stem)
                    element.set(key, self._copied(source, element, "" if urdf else before))
        if urdf:
            _assets_of_urdf(root)
        ET.indent(root)
        return f"{ET.tostring(root, 'unicode')}\n"

    def _expanded(self, path: Path, home: Path, inside: tuple[Path, ...], places: dict[ET.Element, Path]) -> ET.Element:
        """The root of a file, whose includes are replaced by what they contain; `places` gets its elements."""
        if path.resolve() in inside or len(inside) > DEEPEST_MODEL:
            raise InputError(f"{path}: it includes itself, or files include each other more than {DEEPEST_MODEL} deep")
        root = self._parsed(path)
        inside = (*inside, path.resolve())
        waiting = [(root, 0)]
        while waiting:
            parent, depth = waiting.pop()
            if depth > DEEPEST_MODEL:
                raise InputError(f"{path}: its elements are nested more than {DEEPEST_MODEL} deep; {_HINT}")
            children: list[ET.Element] = []
            for child in parent:
                if child.tag == "include":
                    included = self._source(child.get("file", ""), [path.parent, home], [], child, "file")
                    children += self._expanded(included, home, inside, places)
                else:
                    waiting.append((child, depth + 1))
                    children.append(child)
            parent[:] = children
            places.setdefault(parent, path.parent)
        return root

    def _parsed(self, path: Path) -> ET.Element:
        self._count()
        try:
            text = read_bounded_text(path, LARGEST_XML)
            self._letters += len(text)
            if self._letters > LARGEST_XML:
                raise ValueError(f"with it the XML files are larger than {LARGEST_XML} bytes together")
            if "<!ENTITY" in text:
                raise ValueError("has entities, which MuJoCo does not read")
            return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
        except (OSError, ValueError, ET.ParseError) as error:
            reason = message_of(error)
            raise InputError(f"{reason if str(path) in reason else f'{path}: {reason}'}; {_HINT}") from None

    def _source(self, value: str, homes: list[Path], folders: list[str], element: ET.Element, key: str) -> Path:
        """The file that an attribute names, in one of the folders in which MuJoCo looks."""
        if source := self._own_file(value, homes, folders):
            return source
        where = f"{self.main}: " + f"<{element.tag} {element.get('name', ''):.80}".rstrip()
        paths = list(_candidates(value, homes, folders))
        if outside := next(filter(os.path.isfile, paths), None):
            where = f"{where} {key}={value!r:.100}>: this is {outside.resolve()!s:.200}"
            raise InputError(
                f"{where}, which does not lie with the model, so it is not read; copy the file into {self._own[0]}"
            )
        raise InputError(f"{where}>: there is no file {value!r:.100}; MuJoCo would look for {paths[0]!s:.200}")

    def _own_file(self, value: str, homes: list[Path], folders: list[str]) -> Path | None:
        """The first file with this path or name that lies with the model, or in the ROS package that it names."""
        package = value.removeprefix(_PACKAGE).partition("/")[0] if value.startswith(_PACKAGE) else ""
        for path in filter(os.path.isfile, _candidates(value, homes, folders)):
            real = path.resolve()  # a link is where it leads to
            named = [folder for folder in real.parents if folder.name == package and (folder / _MANIFEST).is_file()]
            if any(map(real.is_relative_to, (*self._own, *named))):
                return path
        return None

    def _copied(self, source: Path, element: ET.Element, before: str) -> str:
        """The name of a file in the new folder, where it will be copied once."""
        real = source.resolve()
        if real not in self._names:
            self._count()
            with open_regular(source) as file:
                if file.read(len(GIT_LFS)) == GIT_LFS:
                    raise InputError(f"{self.main}: {source}: {NOT_FETCHED}")
            name = source.name
            number = 2
            while name.lower() in map(str.lower, self._names.values()):
                name = f"{source.stem}_{number}{source.suffix}"
                number += 1
            self._names[real] = name
            self.files[f"{ASSETS}/{name}"] = source
            if element.tag == "model":  # of an <attach>: a model with its own assets, which are beside it
                self.files[f"{ASSETS}/{name}"] = self.text_of(source, "")
            self._bytes += source.stat().st_size
            if self._bytes > LARGEST_ASSETS:
                raise InputError(f"{self.main}: its files are larger than {LARGEST_ASSETS} bytes together")
        return f"{before}{self._names[real]}"

    def _count(self) -> None:
        self._read += 1
        if self._read > MOST_FILES:
            raise InputError(f"{self.main}: it has more than {MOST_FILES} files")


def _own_folders(main: Path) -> list[Path]:
    """Folders whose files belong to a model: its own, the ROS package in which it is, and those beside it."""
    home = main.parent.resolve()
    package = next((folder for folder in home.parents if (folder / _MANIFEST).is_file()), home)
    return [home, package, *(home.parent / name for name in _BESIDE)]


def _candidates(value: str, homes: list[Path], folders: list[str]) -> Iterator[Path]:
    """Where a file may be: by its path, or by its name alone as with `strippath`; for `package://`, also further up."""
    if value.startswith(_PACKAGE):
        package, _, inner = value.removeprefix(_PACKAGE).partition("/")
        for folder in (above for home in homes for above in (home.resolve(), *home.resolve().parents)):
            if folder.name == package:
                yield folder / inner
            yield folder / package / inner
        yield from (folder / inner for home in homes for folder in home.resolve().parents)  # under another name
        value = inner
    for text in (value, Path(value.replace("\\", "/")).name):
        for home in homes:
            yield from (home / folder / text for folder in dict.fromkeys((*folders, "")))


def _discard_visuals(root: ET.Element, own_file: Callable[[str], Path | None]) -> None:
    """Removes from a URDF what is only seen and has no file with the model; MuJoCo does without it, too."""
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            named = [text for element in visual.iter() if (text := element.get("filename", "").strip())]
            if not all(map(own_file, named)):
                link.remove(visual)


def _assets_of_urdf(root: ET.Element) -> None:
    """Says to MuJoCo where the assets of a URDF are, of whose paths it takes the names only."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ET.Element("mujoco")
        root.insert(0, extension)
    compiler = extension.find("compiler")
    (ET.SubElement(extension, "compiler") if compiler is None else compiler).set("meshdir", ASSETS)
