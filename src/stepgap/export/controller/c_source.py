"""A portable controller as C99: one source file and its header, without dynamic memory or global variables.

The code is that of `controller.c.txt`, a port of `CautiousController`, of the searches that it uses and of `Beliefs`.
This module writes the numbers into it: those of the documented model, of which the other exports are made, too, and the
constants of the Python modules by their names.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from math import sqrt
from typing import Any, Final, NamedTuple, final, get_args
from unicodedata import normalize

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.errors import InputError
from stepgap.base.versions import versions_here
from stepgap.control import (
    bounded_search,
    cautious_controller,
    command_before,
    following,
    gauss_newton,
    goal,
    horizon,
    shortfall,
    wrapped_map,
)
from stepgap.control.box_points import box_points, composite_design, irrational_steps
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.passport import passport_lines
from stepgap.export.controller.portable_controller import SAMPLE_RESOLUTION, PortableController
from stepgap.export.controller.step_filter import UNCORRECTED
from stepgap.gauss.kernel import SQUARED_EXPONENTIAL
from stepgap.gauss.monomials import number_of_monomials
from stepgap.learning import beliefs, believed
from stepgap.learning.belief import Belief, Kind
from stepgap.step import Quantity, StepStatus

MODULES: Final = (
    gauss_newton, bounded_search, cautious_controller, command_before, following, goal, horizon, shortfall, wrapped_map,
    beliefs, believed,
)  # fmt: skip
"""Modules whose constants are those of the C code, under the same names."""

_WORDS = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while"
)
KEYWORDS: Final = frozenset(_WORDS.split())  # Words that cannot begin the names of the functions
KINDS: Final = get_args(Kind)  # Where a belief began, by its number in C
PER_LINE: Final = 6  # Numbers in a line of an array

REGRESSION: Final = {
    "kind": "ZERO",
    **dict.fromkeys(("degree", "waves", "squared_exponential", "constant_is_exact", "centre_count"), 0),
    **dict.fromkeys(("noise_std", "unit", "signal"), 0.0),
    **dict.fromkeys(("origin", "scale", "weights", "posterior", "centres", "factor", "slope_scale"), "NULL"),
}
"""Fields of the regression of a state coordinate in C, in their order, with the values where nothing was learned."""


@final
class CSource(NamedTuple):
    """The text of the two files.

    Attributes:
        header: Of `PREFIX.h`.
        code: Of `PREFIX.c`, which includes the header.
    """

    header: str
    code: str


def c_source(controller: PortableController, prefix: str) -> CSource:
    """Writes a controller as C99.

    Args:
        controller: The controller.
        prefix: Begins every public name, and is the name of the files; a C identifier.

    Raises:
        InputError: The prefix is not a C identifier.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,30}", prefix, re.ASCII) or prefix in KEYWORDS:
        raise InputError(
            f"'{prefix}': the functions are named after the file, so its name must be a C identifier: a letter, then "
            "at most 30 letters, digits or underscores, and no word of C, such as controller.c"
        )
    document = model_document(controller)
    features = _features(document)
    code = _template("controller.c.txt")
    sizes = _sizes(controller, document, features)
    constants = {**_constants(), **sizes}
    used = {name: constants[name] for name in sorted(set(re.findall(r"\b[A-Z][A-Z_]+\b", code)) & constants.keys())}
    tables = [
        *(f"#define {name} {_literal(value)}" for name, value in used.items()),
        *_space(controller),
        _array("wave_frequency", features["frequencies"]),
        _array("wave_shift", features["shifts"]),
        *_beliefs(controller),
        *_nominal(document["nominal"]),
        *_residual(document["residual"]["regressions"]),
    ]
    include = f'/* Explained in {prefix}.h. */\n#include "{prefix}.h"'
    code = code.replace("@include@", include).replace("@constants@", "\n".join(tables))
    header = _header(controller, sizes)
    return CSource(header.replace("PREFIX", prefix), code.replace("PREFIX", prefix))


def _template(name: str) -> str:
    return files("stepgap.export.controller").joinpath(name).read_text("utf-8")


def _header(controller: PortableController, sizes: Mapping[str, Any]) -> str:
    space = controller.space
    settings = controller.settings
    statuses = {**{status.name: status.value for status in StepStatus}, "UNCORRECTED": UNCORRECTED}
    noise = ", ".join(
        f"{quantity.name} {std:.3g} {quantity.unit}"
        for quantity, std in zip(space.state, controller.map.noise_std, strict=True)
    )
    change = f"; planned ones differ from `guess` by at most {settings.largest_change:g} of their range"
    notes = [*controller.approximations, *controller.notes]
    fields = {
        "title": "A step controller that was learned by StepGap: the command with which the next state is a target.",
        "version": versions_here()["stepgap"],
        "passport": "\n".join(f"   {_in_comment(line)}" for line in passport_lines(controller.passport)),
        "n": len(space.state),
        "m": len(space.command),
        "state": _quantities(space.state, "range of use"),
        "horizon": settings.horizon,
        "change": change if settings.largest_change < 1 else "",
        "command": _quantities(space.command, "bounds"),
        "noise": _in_comment(noise),
        "approximations": "\n".join(f"   - {_in_comment(note)}" for note in notes) or "   none",
        "features": sizes["FEATURES"],
        "beliefs": sizes["BELIEFS"],
        "surprises": following.SURPRISES,
        "recent": beliefs.RECENT,
        "compared": beliefs.PROBES + beliefs.RECENT,
        "changed": KINDS.index("changed"),
        "earlier": KINDS.index("earlier"),
        "size": _memory(controller, sizes),
        "statuses": ",\n".join(f"    PREFIX_{name} = {value}" for name, value in statuses.items()),
        "stack": _stack(controller, sizes),
    }
    return re.sub("@([a-z]+)@", lambda match: str(fields[match[1]]), _template("controller.h.txt"))


def _quantities(quantities: Iterable[Quantity], what: str) -> str:
    lines = list[str]()
    for index, quantity in enumerate(quantities):
        weight = f", weight {quantity.weight:g}" if quantity.weight else ", not tracked"
        name = f"{_in_comment(quantity.name)} [{_in_comment(quantity.unit)}]"
        ends = f"{what} {quantity.lower:g} to {quantity.upper:g}"
        lines.append(f"       [{index}] {name}, {ends}{'' if quantity.weight == 1 else weight}")
    return "\n".join(lines)


def _in_comment(text: str) -> str:
    """The text in one line of ASCII that cannot end a comment: without trigraphs, backslashes, and * beside /."""
    letters = normalize("NFKD", " ".join(text.replace("→", "->").replace("·", " ").split()))
    plain = re.sub(r"[^ -~]|[\\?@]", "_", letters)
    return re.sub(r"(?<=\*)(?=/)|(?<=/)(?=\*)", " ", plain)


def _memory(controller: PortableController, sizes: Mapping[str, Any]) -> int:
    """About how large the state of a filter is [kB]."""
    n = len(controller.space.state)
    k = sizes["WEIGHTS"]
    rows = beliefs.PROBES + beliefs.RECENT
    moments = n * (k + k * (k + 1) // 2)
    numbers = sizes["BELIEFS"] * (moments + 2 * n * (1 + rows) + 2) + moments + beliefs.RECENT * k + 3 * n + 11
    return -(-(numbers * 8 + 12 * sizes["BELIEFS"]) // 1000)


def _stack(controller: PortableController, sizes: Mapping[str, Any]) -> int:
    """About how much stack the deepest calls need [kB]: a plan of several steps, as gcc compiles it."""
    n = len(controller.space.state)
    m = len(controller.space.command)
    variables = sizes["HORIZON"] * m
    rows = 2 * n * sizes["HORIZON"]
    search = variables * (3 * (rows + variables) + variables + rows)
    planning = 600 + 4 * sizes["CENTRES"] + 10 * n * (n + m) + 4 * sizes["WEIGHTS"] + search
    learning = sizes["BELIEFS"] * (2 * n + 4) + 12 * sizes["WEIGHTS"]
    return -(-max(planning, learning) * 8 // 1000)


def _features(document: Mapping[str, Any]) -> dict[str, Any]:
    """The features of beliefs or of a fitted residual, which may lack waves; without both, those of degree 1.

    Raises:
        InputError: Those of the residual are others.
    """
    parts = [part["features"] for part in document["residual"]["regressions"] if part["kind"] == "posterior"]
    if document["beliefs"] is not None:
        parts.insert(0, document["beliefs"]["features"])
    if any(part != parts[0] and part["shifts"] for part in parts):
        raise InputError("beliefs and residual have different features, which C cannot have; run again")
    inputs = len(document["state"]) + len(document["command"])
    return parts[0] if parts else {"inputs": inputs, "degree": 1, "frequencies": [], "shifts": []}


def _constants() -> dict[str, float]:
    """The numbers that are constants of the Python modules."""
    return {
        name: value
        for module in MODULES
        for name, value in vars(module).items()
        if name.isupper() and isinstance(value, int | float)
    }


def _sizes(
    controller: PortableController, document: Mapping[str, Any], features: Mapping[str, Any]
) -> dict[str, float]:
    """The settings, and the numbers that depend on the controller.

    BELIEFS are most beliefs at once: those at the start or those that are kept, young ones, what was believed earlier,
    and while a step is learned one that is born and one that becomes an earlier one.
    """
    n = len(document["state"])
    m = len(document["command"])
    known_beliefs = controller.beliefs
    regressions = document["residual"]["regressions"]
    evaluations = document["control"]["evaluations"]
    waves = len(features["shifts"])
    count = number_of_monomials(features["inputs"], features["degree"]) + waves
    design = len(composite_design(m))
    coarse, fine = (len(box_points(size, m)) for size in bounded_search.SEARCHED)
    centres = max([1, *(len(part["centres"]) for part in regressions if part["kind"] == "gaussian_process")])
    degrees = document["nominal"].get("degrees", [[1]])
    return {
        **{name.upper(): float(value) if isinstance(value, float) else int(value)
           for name, value in document["control"].items() if isinstance(value, int | float)},
        "SURPRISE": document["control"]["surprise"] or 0.0,
        "LIMITED": int(controller.farthest is not None),
        "PLANAR": int(controller.space.planar_seconds > 0),
        "PLANAR_SECONDS": float(controller.space.planar_seconds),
        "FEATURES": count,
        "WEIGHTS": count + 2 + n + m,
        "BELIEFS": 1 if known_beliefs is None else max(len(known_beliefs.beliefs), beliefs.MOST) + beliefs.YOUNG + 3,
        "LAGGED": int(controller.space.is_lagged),
        "BELIEVES": int(known_beliefs is not None),
        "START_COUNT": len(known_beliefs.beliefs) if known_beliefs else 0,
        "CURRENT": KINDS.index("current"),
        "FEATURE_DEGREE": features["degree"],
        "WAVES": waves,
        "WAVE_AMPLITUDE": sqrt(2.0 / max(waves, 1)),
        "DEGREE": max(1, int(np.max(degrees))),
        "CENTRES": centres,
        "MOST_FEATURES": max(centres + n + m + 1, *(len(part.get("weights", [])) for part in regressions)),
        "SAMPLE_RESOLUTION": SAMPLE_RESOLUTION,
        "STATIONARY": 1e-14,
        "SMALLEST_MOVE": 1e-100,
        "ZOOM_SIZE": len(box_points(bounded_search.ZOOMED, m)),
        "COARSE_SIZE": coarse,
        "FINE_SIZE": fine,
        "SAMPLE_SIZE": max([1, *(size for size in (coarse, fine) if size <= evaluations // 2)]),
        "SEARCH_SIZE": len(box_points(cautious_controller.searched_commands(controller.settings), m)),
        "DESIGN_SIZE": design,
        "OPPOSITE": max(1, (design - 1 - 2 * m) // 2),
    }  # fmt: skip


def _space(controller: PortableController) -> list[str]:
    space = controller.space
    failures = controller.failures
    return [
        _array("input_scale", [*space.state_scale, *space.command_scale]),
        _array("input_centre", [*space.state_centre, *space.command_centre]),
        _array("command_lower", space.command_lower),
        _array("command_upper", space.command_upper),
        _array("error_scale", np.where(space.tracked, space.error_scale, 0.0)),
        _array("farthest", [] if controller.farthest is None else controller.farthest),
        _array("irrational_steps", irrational_steps(len(space.command))),
        _array("failures", failures),
        f"static const int failure_count = {len(failures)};",
    ]


def _beliefs(controller: PortableController) -> list[str]:
    start_beliefs = controller.beliefs
    if start_beliefs is None:
        return [
            _array("probe_features", []),
            _array("change", []),
            "static const PREFIX_belief *const start = NULL;",
            "#define WRONG_ENDS 0",
            "#define RIGHT_ENDS 0",
        ]
    upper = np.triu_indices(start_beliefs.change.shape[1])
    wrong, right = start_beliefs.wrong_measurements
    start = ",\n".join(_belief(belief) for belief in start_beliefs.beliefs)
    return [
        _array("probe_features", start_beliefs.features(start_beliefs.probes)),
        _array("change", start_beliefs.change[:, *upper]),
        f"static const PREFIX_belief start[START_COUNT] = {{\n{start}\n}};",
        f"#define WRONG_ENDS {_literal(float(wrong))}",
        f"#define RIGHT_ENDS {_literal(float(right))}",
    ]


def _belief(belief: Belief) -> str:
    """The initial value of a belief; roots column by column, as the transposed matrices row by row."""
    columns = np.swapaxes(belief.weights.root, 1, 2)[:, *np.triu_indices(belief.weights.root.shape[1])]
    parts = [
        str(KINDS.index(belief.kind)),
        str(belief.age),
        _literal(float(belief.rate)),
        _literal(float(belief.log_weight)),
        _numbers(belief.freedom),
        _numbers(belief.squares),
        "{" + ",\n".join(map(_numbers, belief.weights.mean)) + "}",
        "{" + ",\n".join(map(_numbers, columns)) + "}",
        "{{0}}",
        "{{0}}",
    ]
    return "{" + ", ".join(parts) + "}"


def _nominal(nominal: Mapping[str, Any]) -> list[str]:
    """The nominal map: `centre` and `scale` are those of its inputs. An affine one is a polynomial of degree 1."""
    samples = nominal.get("samples", {"points": [], "status": []})
    if nominal["kind"] == "affine":
        centre = [*nominal["state"], *nominal["command"]]
        size = len(centre)
        degrees = np.vstack([np.zeros((1, size)), np.eye(size)])
        weights = np.vstack([nominal["next_state"], np.transpose(nominal["matrix"])])
        scale = np.ones(size)
    else:
        centre, scale, degrees, weights = (nominal[key] for key in ("centre", "scale", "degrees", "weights"))
    return [
        _array("nominal_centre", centre),
        _array("nominal_scale", scale),
        _array("nominal_weights", weights),
        _array("nominal_degrees", degrees, "unsigned char"),
        _array("nominal_samples", np.array(samples["points"]) / SAMPLE_RESOLUTION, "int16_t"),
        _array("nominal_sample_status", samples["status"], "unsigned char"),
        f"enum {{ TERMS = {len(degrees)}, SAMPLE_COUNT = {len(samples['status'])} }};",
    ]


def _residual(regressions: Sequence[Mapping[str, Any]]) -> list[str]:
    arrays = list[str]()
    rows = list[str]()
    for number, part in enumerate(regressions):
        fields = {**REGRESSION, **_regression(part), "noise_std": float(part["noise_std"])}
        for key, value in fields.items():
            if isinstance(value, np.ndarray):
                arrays.append(_array(f"residual_{number}_{key}", value))
                fields[key] = f"residual_{number}_{key}"
        texts = [value if isinstance(value, str) else _literal(value) for value in fields.values()]
        rows.append(f"    {{{', '.join(texts)}}}")
    table = ",\n".join(rows)
    return [*arrays, f"static const regression residual[N] = {{\n{table}\n}};"]


def _regression(part: Mapping[str, Any]) -> dict[str, Any]:
    """The fields in which a regression differs from one that learned nothing."""
    if part["kind"] == "zero":
        return {}
    if part["kind"] == "gaussian_process":
        scale = np.array(part["slope_scale"])
        slopes = np.divide(part["slopes"], scale, out=np.zeros_like(scale), where=scale > 0)
        return {
            "kind": "GAUSSIAN_PROCESS",
            "squared_exponential": int(part["kernel"] == SQUARED_EXPONENTIAL.name),
            "constant_is_exact": int(part["constant_is_exact"]),
            "centre_count": len(part["centres"]),
            "unit": 1.0,
            "signal": float(part["signal_std"]),
            "origin": np.array(part["origin"]),
            "scale": np.array(part["length_scale"]),
            "weights": np.array([*part["weights"], *slopes, part["constant"]]),
            "posterior": _triangle(part["weight_factor"]),
            "centres": np.array(part["centres"]) / part["length_scale"],
            "factor": _triangle(part["centre_factor"]),
            "slope_scale": scale,
        }
    of_polynomial = part["kind"] == "polynomial"
    return {
        "kind": "WEIGHTED",
        "degree": int(np.sum(part["degrees"], axis=1).max()) if of_polynomial else part["features"]["degree"],
        "waves": 0 if of_polynomial else len(part["features"]["shifts"]),
        "unit": 1.0 if of_polynomial else float(part["value_scale"]),
        "origin": np.array(part["centre"]),
        "scale": np.array(part["scale"]),
        "weights": np.array(part["weights"]),
        "posterior": _triangle(part["covariance"]),
    }


def _triangle(matrix: ArrayLike) -> np.ndarray:
    """The lower triangle, row by row."""
    whole = np.array(matrix)
    return whole[np.tril_indices(len(whole))]


def _literal(value: float) -> str:
    return str(value) if isinstance(value, int) else repr(float(value))


def _numbers(values: ArrayLike, kind: str = "double") -> str:
    """The initial value of an array."""
    numbers = np.ravel(values).tolist()
    texts = [repr(float(value)) if kind == "double" else str(int(value)) for value in numbers]
    lines = [", ".join(texts[start : start + PER_LINE]) for start in range(0, len(texts), PER_LINE)]
    return "{\n    " + ",\n    ".join(lines) + "\n}"


def _array(name: str, values: ArrayLike, kind: str = "double") -> str:
    """A constant array; a null pointer if it is empty, since C has no empty arrays."""
    size = np.size(values)
    if not size:
        return f"static const {kind} *const {name} = NULL;"
    return f"static const {kind} {name}[{size}] = {_numbers(values, kind)};"
