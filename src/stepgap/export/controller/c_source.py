"""A portable controller as C99: one source file and its header, without libraries, dynamic memory or global variables.

The code is that of `controller.c.txt`, a port of `CautiousController`, of the searches that it uses and of `Trust`.
This module writes the numbers into it: the ranges, the nominal map, the residual, the failures, and the settings and
constants of the Python modules, so that both agree.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, Literal, NamedTuple, final
from unicodedata import normalize

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.versions import versions_here
from stepgap.control import bounded_search, cautious_controller, gauss_newton, goal, horizon
from stepgap.control.box_points import box_points, composite_design, irrational_steps
from stepgap.export.controller.passport import passport_lines
from stepgap.export.controller.portable_controller import SAMPLE_RESOLUTION, PortableController
from stepgap.export.controller.step_filter import UNCORRECTED
from stepgap.gauss.kernel import SQUARED_EXPONENTIAL
from stepgap.gauss.sparse_gaussian_process import SparseGaussianProcess
from stepgap.learning import disturbance, outliers, trust
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.polynomial import Polynomial
from stepgap.learning.regression import Regression
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap, exponents_of
from stepgap.step import Quantity, StepStatus

Real = Literal["double", "float"]
"""Type of all numbers of the C code."""

_WORDS = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while real"
)
KEYWORDS: Final = frozenset(_WORDS.split())
"""Words that cannot begin the names of the functions."""

HYPOTHESES: Final = 3 + 3 * trust.CANDIDATES
"""Most hypotheses at once: current, nominal, a change at this step, and those of earlier changes that are kept."""

PER_LINE: Final = 6
"""Numbers in a line of an array."""


@final
class CSource(NamedTuple):
    """The text of the two files.

    Attributes:
        header: Of `PREFIX.h`.
        code: Of `PREFIX.c`, which includes the header.
    """

    header: str
    code: str


@final
@dataclass(frozen=True)
class _Arithmetic:
    """What depends on the type of the numbers: constants of the elementary functions, and tolerances.

    Attributes:
        type: Name of the type in C.
        definitions: C definitions.
        tolerances: In place of those of `gauss_newton`, which are below the resolution of `float`.
        largest_angle: Largest phase whose sine is computed [rad].
    """

    type: Real
    definitions: str
    tolerances: dict[str, float]
    largest_angle: float


_DOUBLE: Final = _Arithmetic(
    "double",
    """typedef uint64_t real_bits;
#define SMALLEST_NORMAL 2.2250738585072014e-308
#define INFINITE 1.7976931348623157e308 /* stands for infinity */
#define EPSILON 2.220446049250313e-16
#define LEAST_EXPONENT (-708.0)
#define LOG_2_HIGH 6.93147180369123816490e-01
#define LOG_2_LOW 1.90821492927058770002e-10
#define HALF_PI_HIGH 1.57079632673412561417e+00
#define HALF_PI_MIDDLE 6.07710050630396597660e-11
#define HALF_PI_LOW 2.02226624879595063154e-21
#define HALF_BIAS ((real_bits)1023 << 51)
enum { EXPONENT_BIAS = 1023, MANTISSA_BITS = 52, TAYLOR_TERMS = 14, NEWTON_STEPS = 5 };""",
    {
        "TOLERANCE": gauss_newton.TOLERANCE,
        "REACHED": gauss_newton.REACHED,
        "FLAT": gauss_newton.FLAT,
        "IMPROVEMENT": cautious_controller.IMPROVEMENT,
        "STATIONARY": 1e-14,
        "SMALLEST_MOVE": 1e-100,
    },
    1e6,
)
_FLOAT: Final = _Arithmetic(
    "float",
    """typedef uint32_t real_bits;
#define SMALLEST_NORMAL 1.17549435e-38f
#define INFINITE 3.40282347e38f /* stands for infinity */
#define EPSILON 1.1920929e-07f
#define LEAST_EXPONENT (-87.0f)
#define LOG_2_HIGH 6.9313812256e-01f
#define LOG_2_LOW 9.0580006145e-06f
#define HALF_PI_HIGH 1.5707855225e+00f
#define HALF_PI_MIDDLE 1.0804334124e-05f
#define HALF_PI_LOW 6.0770943833e-11f
#define HALF_BIAS ((real_bits)127 << 22)
enum { EXPONENT_BIAS = 127, MANTISSA_BITS = 23, TAYLOR_TERMS = 8, NEWTON_STEPS = 4 };""",
    {
        "TOLERANCE": 1e-6,
        "REACHED": 1e-5,
        "FLAT": 1e-5,
        "IMPROVEMENT": 1e-5,
        "STATIONARY": 1e-6,
        "SMALLEST_MOVE": 1e-30,
    },
    1e4,
)


def c_source(controller: PortableController, prefix: str, real: Real = "double") -> CSource:
    """Writes a controller as C99.

    Args:
        controller: The controller.
        prefix: Begins every public name, and is the name of the files; a C identifier.
        real: Type of all numbers.

    Raises:
        InputError: The prefix is not a C identifier.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,30}", prefix, re.ASCII) or prefix in KEYWORDS:
        raise InputError(
            f"'{prefix}': the functions are named after the file, so its name must be a C identifier: a letter, then "
            "at most 30 letters, digits or underscores, and no word of C, such as controller.c"
        )
    arithmetic = _DOUBLE if real == "double" else _FLOAT
    tables = _Tables(controller, arithmetic)
    include = f'/* Explained in {prefix}.h. */\n#include "{prefix}.h"'
    body = _template("controller.c.txt").replace("@include@", include).replace("@constants@", tables.text())
    header = _header(controller, arithmetic, tables.stack())
    return CSource(header.replace("PREFIX", prefix), body.replace("PREFIX", prefix))


def _template(name: str) -> str:
    return files("stepgap.export.controller").joinpath(name).read_text("utf-8")


def _header(controller: PortableController, arithmetic: _Arithmetic, stack: int) -> str:
    space = controller.space
    noise = zip(space.state, controller.map.noise_std, strict=True)
    notes = [*map(str, controller.approximations), *controller.notes]
    statuses = {**{each.name: each.value for each in StepStatus}, "UNCORRECTED": UNCORRECTED}
    noises = ", ".join(f"{quantity.name} {std:.3g} {quantity.unit}" for quantity, std in noise)
    fields = {
        "title": "A step controller that was learned by StepGap: the command with which the next state is a target.",
        "version": versions_here()["stepgap"],
        "passport": "\n".join(f"   {_in_comment(line)}" for line in passport_lines(controller.passport)),
        "n": str(len(space.state)),
        "m": str(len(space.command)),
        "state": _quantities(space.state, "range of use"),
        "horizon": str(controller.settings.horizon),
        "change": _change(controller.settings.largest_change),
        "command": _quantities(space.command, "bounds"),
        "noise": _in_comment(noises),
        "approximations": "\n".join(f"   - {_in_comment(note)}" for note in notes) or "   none",
        "real": arithmetic.type,
        "filters": str(len(disturbance.FORGETTING)),
        "hypotheses": str(HYPOTHESES),
        "size": str(_filter_size(len(space.state), len(space.command), arithmetic.type)),
        "statuses": ",\n".join(f"    PREFIX_{name} = {value}" for name, value in statuses.items()),
        "angle": f"{arithmetic.largest_angle:g}",
        "stack": str(stack),
    }
    return re.sub("@([a-z]+)@", lambda found: fields[found[1]], _template("controller.h.txt"))


def _filter_size(n: int, m: int, real: Real) -> int:
    """About how large the state of trust is [kB]."""
    filters, regressors = len(disturbance.FORGETTING), 3 + n + m
    bank = filters * (regressors * n + regressors * (regressors + 1) // 2) + (1 + filters) * n + 2
    return -(-HYPOTHESES * bank * (8 if real == "double" else 4) // 1000)


def _quantities(quantities: Iterable[Quantity], what: str) -> str:
    return "\n".join(
        f"       [{i}] {_in_comment(each.name)} [{_in_comment(each.unit)}], {what} {each.lower:g} to {each.upper:g}"
        f"{'' if each.weight == 1 else f', weight {each.weight:g}' if each.weight else ', not tracked'}"
        for i, each in enumerate(quantities)
    )


def _change(largest: float) -> str:
    """What holds of the command and the one before."""
    return f"; it differs from `guess` by at most {largest:g} of its range" if largest < 1 else ""


def _in_comment(text: str) -> str:
    """The text in one line of ASCII that cannot end a comment: without trigraphs, backslashes, and * beside /."""
    letters = normalize("NFKD", " ".join(text.replace("→", "->").replace("·", " ").split()))
    plain = re.sub(r"[^ -~]|[\\?@]", "_", letters)
    return re.sub(r"(?<=\*)(?=/)|(?<=/)(?=\*)", " ", plain)


@final
class _Tables:
    """Writes the constants of a controller."""

    def __init__(self, controller: PortableController, arithmetic: _Arithmetic):
        self.controller = controller
        self.arithmetic = arithmetic

    def text(self) -> str:
        """All constants."""
        parts = [
            self.arithmetic.definitions,
            *(f"#define {name} R({value!r})" for name, value in self._numbers().items()),
            f"enum {{ {', '.join(f'{name} = {value}' for name, value in self._sizes().items())} }};",
            "enum { AFFINE, POLYNOMIAL_MAP };",
            "enum { ZERO, POLYNOMIAL, GAUSSIAN_PROCESS };",
            "enum { MATERN_52, SQUARED_EXPONENTIAL };",
            *self._space(),
            *self._filters(),
            self._nominal(),
            self._residual(),
        ]
        return "\n".join(parts)

    def stack(self) -> int:
        """About how much stack the deepest calls need [kB]: a plan of several steps, as gcc compiles it."""
        n, m = len(self.controller.space.state), len(self.controller.space.command)
        sizes = self._sizes()
        variables, rows = sizes["HORIZON"] * m, 2 * n * sizes["HORIZON"]
        search = variables * (3 * (rows + variables) + variables + rows)
        numbers = 600 + 4 * sizes["CENTRES"] + 10 * n * (n + m) + search
        return -(-numbers * (8 if self.arithmetic.type == "double" else 4) // 1000)

    def _numbers(self) -> dict[str, float]:
        first = trust.first_hazards(warm_start=self.controller.warm_start)
        return {
            **self.arithmetic.tolerances,
            "NEARBY": gauss_newton.NEARBY,
            "MOST_DAMPING": gauss_newton.MOST_DAMPING,
            "LEAST_DAMPING": gauss_newton.LEAST_DAMPING,
            "NO_DAMPING": gauss_newton.NO_DAMPING,
            "ACCEPTED": gauss_newton.ACCEPTED,
            "AHEAD_IMPROVEMENT": horizon.AHEAD_IMPROVEMENT,
            "LARGEST_CHANGE": self.controller.settings.largest_change,
            "CAUTION": goal.CAUTION,
            "RISK": cautious_controller.RISK,
            "SEPARATION": bounded_search.SEPARATION,
            "FAILURE_RADIUS": cautious_controller.FAILURE_RADIUS,
            "SCORE_MEMORY": disturbance.SCORE_MEMORY,
            "SWITCHING_PENALTY": disturbance.SWITCHING_PENALTY,
            "CHANGE_STD": disturbance.CHANGE_STD,
            "SLOPE_STD": disturbance.SLOPE_STD,
            "LOG_FIRST_CHANGED": math.log(first["changed"]),
            "LOG_FIRST_NOMINAL": math.log(first["nominal"]),
            "LOG_SWITCHING_ODDS": math.log(trust.SWITCHING_ODDS),
            "STRAINING": trust.STRAINING,
            "LEAST_ERROR": trust.LEAST_ERROR,
            "LARGEST_DEVIATION": trust.LARGEST_DEVIATION,
            "SAMPLE_RESOLUTION": SAMPLE_RESOLUTION,
            "IMPROBABLE": outliers.IMPROBABLE,
            "LEAST_STD": outliers.LEAST_STD,
            "OUTLIER_WIDTH": outliers.OUTLIER_WIDTH,
            "LOG_REGULAR": math.log1p(-outliers.OUTLIER_PROBABILITY),
            "LOG_OUTLIER": math.log(outliers.OUTLIER_PROBABILITY),
            "LARGEST_ANGLE": self.arithmetic.largest_angle,
        }

    def _sizes(self) -> dict[str, int]:
        settings, m = self.controller.settings, len(self.controller.space.command)
        nominal, regressions = self.controller.map.nominal, self.controller.map.residual.regressions
        coarse, fine = (len(box_points(count, m)) for count in bounded_search.SEARCHED)
        design = len(composite_design(m))
        half = settings.evaluations // 2
        centres = [len(_process(each).inducing) for each in regressions if isinstance(each, GaussianProcessRegression)]
        return {
            "HORIZON": settings.horizon,
            "DEGREE": nominal.degree if isinstance(nominal, SurrogateMap) else 1,
            "CENTRES": max(centres, default=1),
            "MOST_TRIALS": gauss_newton.MOST_TRIALS,
            "BASINS": bounded_search.BASINS,
            "ZOOM_ROUNDS": bounded_search.ZOOM_ROUNDS,
            "ZOOM_SIZE": len(box_points(bounded_search.ZOOMED, m)),
            "COARSE_SIZE": coarse,
            "FINE_SIZE": fine,
            "SAMPLE_SIZE": max([1, *(size for size in (coarse, fine) if size <= half)]),
            "SEARCH_SIZE": len(box_points(cautious_controller.searched_commands(settings), m)),
            "DESIGN_SIZE": design,
            "OPPOSITE": max(1, (design - 1 - 2 * m) // 2),
            "EVALUATIONS": settings.evaluations,
            "CAUTIOUS": int(settings.cautious),
            "VIABILITY": int(settings.viability),
            "AVOID_FAILURES": int(settings.avoid_failures),
            "DRIFT": int(self.controller.drift),
            "MONITOR": int(self.controller.monitor),
            "JUDGES": int(self.controller.judges),
            "REJECT_OUTLIERS": int(self.controller.reject_outliers),
            "CANDIDATES": trust.CANDIDATES,
            "MOST_STRAINED": trust.MOST_STRAINED,
            "YOUNG": trust.YOUNG,
        }

    def _space(self) -> list[str]:
        space, failures = self.controller.space, self.controller.failures
        names = "state_scale", "state_centre", "command_scale", "command_centre", "command_lower", "command_upper"
        arrays = [self._array(name, getattr(space, name)) for name in names]
        arrays.append(self._array("error_scale", np.where(space.tracked, space.error_scale, 0.0)))
        arrays.append(self._array("irrational_steps", irrational_steps(len(space.command))))
        return [*arrays, self._array("failures", failures), f"static const int failure_count = {len(failures)};"]

    def _filters(self) -> list[str]:
        strengths = np.repeat(disturbance.FILTER_STRENGTHS, len(disturbance.RATES))
        return [
            self._array("filter_strength", strengths),
            self._array("filter_forgetting", disturbance.FORGETTING),
            self._array(
                "log_hazard", np.log([1.0, *(trust.HAZARDS[key] for key in ("changed", "nominal", "earlier"))])
            ),
        ]

    def _nominal(self) -> str:
        """The nominal map: `centre` and `scale` are those of its inputs."""
        nominal = self.controller.map.nominal
        declaration = (
            "static const struct {\n    int kind, terms, sample_count;\n"
            "    const real *centre, *scale, *next_state, *weights;\n"
            "    const unsigned char *exponents;\n    const int16_t *samples;\n"
            "    const unsigned char *sample_status;\n"
            "} nominal = "
        )
        if isinstance(nominal, AffineMap):
            arrays = [
                self._array("nominal_centre", np.concatenate([nominal.state, nominal.command])),
                self._array("nominal_next_state", nominal.next_state),
                self._array("nominal_weights", nominal.matrix),
            ]
            fields = "{AFFINE, 0, 0, nominal_centre, NULL, nominal_next_state, nominal_weights, NULL, NULL, NULL};"
            return "\n".join([*arrays, declaration + fields])
        if not isinstance(nominal, SurrogateMap):
            raise TypeError(f"{type(nominal).__name__} is not the map of a portable controller")
        samples, dimension = nominal.samples, len(self.controller.space.names)
        exponents = exponents_of(dimension, nominal.degree)
        arrays = [
            self._array("nominal_centre", nominal.centre),
            self._array("nominal_scale", nominal.scale),
            self._array("nominal_weights", nominal.weights),
            _integers("nominal_exponents", "unsigned char", exponents),
        ]
        if len(samples.status):
            arrays.append(_integers("nominal_samples", "int16_t", samples.points / SAMPLE_RESOLUTION))
            arrays.append(_integers("nominal_sample_status", "unsigned char", samples.status))
        sampled = "nominal_samples, nominal_sample_status" if len(samples.status) else "NULL, NULL"
        fields = (
            f"{{POLYNOMIAL_MAP, {len(exponents)}, {len(samples.status)}, nominal_centre, nominal_scale, NULL,\n"
            f"    nominal_weights, nominal_exponents, {sampled}}};"
        )
        return "\n".join([*arrays, declaration + fields])

    def _residual(self) -> str:
        declaration = (
            "typedef struct {\n    int kind, degree, kernel, plug_in, centre_count;\n    real noise_std, signal;\n"
            "    const real *origin, *scale, *weights, *posterior, *centres, *factor, *slope_scale;\n} regression;"
        )
        arrays, rows = [], []
        for i, each in enumerate(self.controller.map.residual.regressions):
            found, row = self._regression(f"residual_{i}", each)
            arrays += found
            rows.append(f"    {{{row}}}")
        table = ",\n".join(rows)
        return "\n".join([declaration, *arrays, f"static const regression residual[N] = {{\n{table}\n}};"])

    def _regression(self, name: str, regression: Regression) -> tuple[list[str], str]:
        """Arrays of a regression, and its row in the table."""
        noise = self._literal(regression.noise_std)
        if isinstance(regression, Polynomial):
            moments = regression.moments
            weights, inverse, noise_variance = moments.solve(np.eye(len(moments.projection)))
            arrays = {
                "origin": regression.data.centre,
                "scale": regression.data.scale,
                "weights": weights,
                "posterior": _triangle(noise_variance * inverse),
            }
            pointers = ", ".join(f"{name}_{each}" for each in arrays)
            head = f"POLYNOMIAL, {regression.degree}, 0, 0, 0, {noise}, {self._literal(0.0)}"
            row = f"{head}, {pointers}, NULL, NULL, NULL"
        elif isinstance(regression, GaussianProcessRegression):
            process = _process(regression)
            inducing, mean = process.inducing, process.posterior.mean
            covariance = process.hyper_parameters.covariance(process.kernel, inducing, process.input_scale)
            kernel_weights = process.inducing_factor.solve_transposed(mean[: len(inducing)])
            arrays = {
                "origin": covariance.origin,
                "scale": covariance.length_scale,
                "weights": np.concatenate([kernel_weights, mean[len(inducing) :]]),
                "posterior": _triangle(process.posterior.factor.assembled()),
                "centres": inducing / covariance.length_scale,
                "factor": _triangle(process.inducing_factor.assembled()),
                "slope_scale": covariance.slope_scale,
            }
            kernel = "SQUARED_EXPONENTIAL" if process.kernel is SQUARED_EXPONENTIAL else "MATERN_52"
            signal = self._literal(process.hyper_parameters.signal_std)
            pointers = ", ".join(f"{name}_{each}" for each in arrays)
            plug_in, count = int(regression.plug_in), len(process.inducing)
            row = f"GAUSSIAN_PROCESS, 0, {kernel}, {plug_in}, {count}, {noise}, {signal}, {pointers}"
        else:
            zero = self._literal(0.0)
            return [], f"ZERO, 0, 0, 0, 0, {noise}, {zero}, NULL, NULL, NULL, NULL, NULL, NULL, NULL"
        return [self._array(f"{name}_{key}", value) for key, value in arrays.items()], row

    def _literal(self, value: float) -> str:
        if self.arithmetic.type == "double":
            return repr(float(value))
        return f"{float(f'{np.float32(value):.9g}')!r}f"

    def _array(self, name: str, values: np.ndarray) -> str:
        return _declaration(name, "real", [self._literal(value) for value in np.ravel(values)])


def _integers(name: str, kind: str, values: np.ndarray) -> str:
    return _declaration(name, kind, [str(int(value)) for value in np.ravel(values)])


def _declaration(name: str, kind: str, numbers: list[str]) -> str:
    """A constant array; a null pointer if it is empty, since C has no empty arrays."""
    if not numbers:
        return f"static const {kind} *const {name} = NULL;"
    lines = [", ".join(numbers[start : start + PER_LINE]) for start in range(0, len(numbers), PER_LINE)]
    body = ",\n    ".join(lines)
    return f"static const {kind} {name}[{len(numbers)}] = {{\n    {body}\n}};"


def _triangle(matrix: np.ndarray) -> np.ndarray:
    """The lower triangle, row by row."""
    return matrix[np.tril_indices(len(matrix))]


def _process(regression: GaussianProcessRegression) -> SparseGaussianProcess:
    if not isinstance(regression.process, SparseGaussianProcess):
        raise TypeError(f"{type(regression.process).__name__} is not the process of a portable controller")
    return regression.process
