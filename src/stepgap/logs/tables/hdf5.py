"""HDF5 files, among them MATLAB's MAT files of version 7.3; nothing outside the file is read."""

from collections.abc import Sequence
from math import prod
from pathlib import Path
from typing import Any

from stepgap.logs.tables.arrays import only_for_matlab, part_name, tables_of_arrays
from stepgap.logs.tables.files import LARGEST_PART, check_file_size, leaving_out, library, reading
from stepgap.logs.tables.log_table import LogTable, check_size
from stepgap.records.steps_csv import RecordError

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"

_MOST_OBJECTS = 10_000
_DEEPEST = 20


def read_hdf5(matlab: bool, path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The datasets of a file, one table for each group.

    Args:
        matlab: Whether the conventions are those of MATLAB 7.3: dimensions reversed, structs as groups.
        unread: The datasets and links that cannot be read are added to it, with the reasons.
    """
    h5py = library("h5py", path)
    check_file_size(path)
    with reading(path, "HDF5"), h5py.File(path, "r") as file:
        datasets = _Datasets(h5py, file, path, matlab, unread).by_name
        sizes = [max(float(dataset.size), dataset.nbytes / 8) for dataset in datasets.values()]  # text may be long
        check_size(str(path), sum(sizes))
        arrays: list[tuple[str, str, Any]] = []
        for names, dataset in datasets.items():
            with leaving_out(_part(names), unread):
                if not matlab:
                    arrays.append(_array(h5py, names, dataset))
                elif _is_matlab_number(dataset):
                    arrays.append(_matlab_array(names, _values(h5py, dataset)))
        return tables_of_arrays(str(path), arrays, unread)


def _part(names: Sequence[str]) -> str:
    return part_name("/".join(names[:-1]), names[-1])


class _Datasets:
    """The datasets of a file by their names from the root to them; links to elsewhere are left out."""

    def __init__(self, h5py: Any, file: Any, path: Path, matlab: bool, unread: dict[str, str]) -> None:
        self.by_name: dict[tuple[str, ...], Any] = {}
        self._h5py = h5py
        self._file = file
        self._path = path
        self._matlab = matlab
        self._unread = unread
        self._count = 0
        if fault := file.visititems_links(self._visit):  # each group once, also where groups form a cycle
            raise fault

    def _visit(self, place: str, link: Any) -> RecordError | None:
        """Visits a link; an error, which h5py must not see raised, ends the visit."""
        names = tuple(place.split("/"))
        try:
            if not any(name.startswith("#") for name in names):  # those are what MATLAB refers to
                self._add(names, self._file, place, link)
        except RecordError as error:
            return error
        return None

    def _add(self, names: tuple[str, ...], group: Any, place: str, link: Any) -> None:
        """Adds the dataset at a link of a group."""
        with leaving_out(_part(names), self._unread):
            if isinstance(link, self._h5py.ExternalLink):
                raise ValueError("a link to another file, which is not followed")
            if isinstance(link, self._h5py.SoftLink):
                raise ValueError(f"a link to {link.path!s:.60}, which is not followed")
            self._add_entry(names, group[place], by_reference=False)

    def _add_entry(self, names: tuple[str, ...], entry: Any, by_reference: bool) -> None:
        self._count += 1
        if self._count > _MOST_OBJECTS or len(names) > _DEEPEST:
            limit = f"more than {_MOST_OBJECTS} objects or {_DEEPEST} nested groups"
            raise RecordError(f"{self._path}, {'/'.join(names):.200}: {limit}")
        if not isinstance(entry, self._h5py.Dataset):
            for name in entry if by_reference else ():  # others are visited
                self._add((*names, name), entry, name, entry.get(name, getlink=True))
            return
        if entry.external or entry.is_virtual:
            raise ValueError("its values lie in another file, which is not read")
        if prod(entry.chunks or ()) * entry.dtype.itemsize > LARGEST_PART:
            raise ValueError(f"parts larger than {LARGEST_PART} bytes")
        if self._matlab and self._h5py.check_ref_dtype(entry.dtype) is not None:
            self._add_referred(names, entry)
        elif entry.shape is not None:
            self.by_name[names] = entry

    def _add_referred(self, names: tuple[str, ...], entry: Any) -> None:
        """Adds what the elements of a cell array, or of a field of an array of structs, refer to."""
        if entry.size > _MOST_OBJECTS:
            raise ValueError(f"more than {_MOST_OBJECTS} cells")
        is_cell = entry.attrs.get("MATLAB_class", b"") == b"cell" or len(names) == 1
        field = () if is_cell else names[-1:]
        *outer, last = names[: len(names) - len(field)]
        for index, reference in enumerate(entry[...].reshape(-1)):
            inner = (*outer, f"{last}[{index}]", *field)
            with leaving_out(_part(inner), self._unread):
                if reference:
                    self._add_entry(inner, self._file[reference], by_reference=True)


def _array(h5py: Any, names: tuple[str, ...], dataset: Any) -> tuple[str, str, Any]:
    text = h5py.check_string_dtype(dataset.dtype) is not None and dataset.dtype.kind == "O"
    values = dataset.asstr()[...].astype(str) if text else _values(h5py, dataset)
    return "/".join(names[:-1]), names[-1], values


def _is_matlab_number(dataset: Any) -> bool:
    """Whether a dataset is an array of numbers for MATLAB, not text and not empty.

    Raises:
        ValueError: It is an object of a class, whose numbers mean something else.
    """
    if "MATLAB_object_decode" in dataset.attrs:
        kind = dataset.attrs.get("MATLAB_class", b"object")
        raise ValueError(only_for_matlab(kind.decode() if isinstance(kind, bytes) else str(kind)))
    is_text = dataset.attrs.get("MATLAB_class", b"double") == b"char"
    return dataset.dtype.kind in "biuf" and not is_text and "MATLAB_empty" not in dataset.attrs


def _matlab_array(names: tuple[str, ...], values: Any) -> tuple[str, str, Any]:
    """MATLAB stores the transposed array."""
    group, name = (names[0], names[1:]) if len(names) > 1 else ("", names)
    return group, ".".join(name), values.T


def _values(h5py: Any, dataset: Any) -> Any:
    """The values of a dataset.

    Raises:
        OSError: They are damaged.
        ValueError: They are compressed in a way that is not installed.
    """
    try:
        return dataset[...]
    except OSError:
        pipeline = dataset.id.get_create_plist()
        filters = [pipeline.get_filter(number) for number in range(pipeline.get_nfilters())]
        named = [(code, name.decode(errors="replace").partition(";")[0]) for code, _, _, name in filters]
        names = [name or str(code) for code, name in named if not h5py.h5z.filter_avail(code)]
        if not names:
            raise
        raise ValueError(f"compressed by {', '.join(names):.60}, which is not installed; write it with gzip") from None
