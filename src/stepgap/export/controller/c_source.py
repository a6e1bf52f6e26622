"""A portable controller as C99: one source file and its header, without libraries, dynamic memory or global variables.

The code is that of `controller.c.txt`, a port of `CautiousController`, of the searches that it uses and of `Beliefs`.
This module writes the numbers into it: the ranges, the nominal map, the residual, the failures, and the settings and
constants of the Python modules, so that both agree.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, Literal, NamedTuple, Self, final, get_args
from unicodedata import normalize

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.versions import versions_here
from stepgap.control import bounded_search, cautious_controller, gauss_newton, goal, horizon
from stepgap.control.box_points import box_points, composite_design, irrational_steps
from stepgap.export.controller.passport import passport_lines
from stepgap.export.controller.portable_controller import SAMPLE_RESOLUTION, PortableController
from stepgap.export.controller.step_filter import UNCORRECTED
from stepgap.gauss.features import Features
from stepgap.gauss.kernel import SQUARED_EXPONENTIAL
from stepgap.gauss.sparse_gaussian_process import SparseGaussianProcess
from stepgap.learning import beliefs, believed
from stepgap.learning.belief import Kind
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.polynomial import Polynomial
from stepgap.learning.posterior import Posterior, features_to_dict
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

KINDS: Final = get_args(Kind)
"""Where a belief began, by its number in C."""

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
    noise, sizes = zip(space.state, controller.map.noise_std, strict=True), _Sizes.of(controller)
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
        "features": str(sizes.features),
        "beliefs": str(sizes.beliefs),
        "recent": str(beliefs.RECENT),
        "compared": str(beliefs.PROBES + beliefs.RECENT),
        "changed": str(KINDS.index("changed")),
        "earlier": str(KINDS.index("earlier")),
        "size": str(sizes.memory(arithmetic.type)),
        "statuses": ",\n".join(f"    PREFIX_{name} = {value}" for name, value in statuses.items()),
        "angle": f"{arithmetic.largest_angle:g}",
        "stack": str(stack),
    }
    return re.sub("@([a-z]+)@", lambda found: fields[found[1]], _template("controller.h.txt"))


@final
@dataclass(frozen=True)
class _Sizes:
    """Sizes of the arrays of a controller.

    Attributes:
        states: n.
        commands: m.
        features: Features of state and command.
        beliefs: Most beliefs at once: those at the start or those that are kept, young ones, what was believed earlier,
            and while a step is learned one that is born and one that becomes an earlier one.
    """

    states: int
    commands: int
    features: int
    beliefs: int

    @classmethod
    def of(cls, controller: PortableController) -> Self:
        """The sizes of a controller."""
        n, m = len(controller.space.state), len(controller.space.command)
        known = controller.beliefs
        most = 1 if known is None else max(len(known.beliefs), beliefs.MOST) + beliefs.YOUNG + 3
        return cls(n, m, features_used(controller).count, most)

    @property
    def weights(self) -> int:
        """Weights of each state coordinate, k."""
        return self.features + 2 + self.states + self.commands

    def memory(self, real: Real) -> int:
        """About how large the state of a filter is [kB]."""
        k, n, rows = self.weights, self.states, beliefs.PROBES + beliefs.RECENT
        moments = n * (k + k * (k + 1) // 2)
        numbers = self.beliefs * (moments + 2 * n * (1 + rows) + 2) + moments + beliefs.RECENT * k
        return -(-(numbers * (8 if real == "double" else 4) + 12 * self.beliefs) // 1000)


def features_used(controller: PortableController) -> Features:
    """The features of beliefs or of a fitted residual, which may lack waves; without both, those of degree 1.

    Raises:
        InputError: Those of the residual are others.
    """
    parts = [each.features for each in controller.residual.regressions if isinstance(each, Posterior)]
    known = [*([controller.beliefs.features] if controller.beliefs else []), *parts]
    inputs = len(controller.space.names)
    for each in known[1:]:
        same = features_to_dict(each) == features_to_dict(known[0])
        if not same and each.waves:
            raise InputError("beliefs and residual have different features, which C cannot have; run again")
    return known[0] if known else Features(inputs, 1, np.empty((0, inputs)), np.empty(0))


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
            "enum { ZERO, WEIGHTED, GAUSSIAN_PROCESS };",
            "enum { MATERN_52, SQUARED_EXPONENTIAL };",
            *self._space(),
            *self._features(),
            *self._beliefs(),
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
        size = _Sizes.of(self.controller)
        learning = size.beliefs * (2 * n + 4) + 12 * size.weights
        numbers = max(600 + 4 * sizes["CENTRES"] + 10 * n * (n + m) + 4 * size.weights + search, learning)
        return -(-numbers * (8 if self.arithmetic.type == "double" else 4) // 1000)

    def _numbers(self) -> dict[str, float]:
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
            "SAMPLE_RESOLUTION": SAMPLE_RESOLUTION,
            "WAVE_AMPLITUDE": math.sqrt(2.0 / max(features_used(self.controller).waves, 1)),
            "PERIODIC_STD": beliefs.PERIODIC_STD,
            "LOG_HAZARD": math.log(beliefs.HAZARD),
            "LOG_RETURN_HAZARD": math.log(beliefs.RETURN_HAZARD),
            "LOG_FIRST_HAZARD": math.log(beliefs.FIRST_HAZARD),
            "WRONG": beliefs.WRONG,
            "WRONG_WIDTH": beliefs.WRONG_WIDTH,
            "WRONG_FREEDOM": beliefs.WRONG_FREEDOM,
            "SUSPECT": beliefs.SUSPECT,
            "WIDER": beliefs.WIDER,
            "LEAST_TRUST": beliefs.LEAST_TRUST,
            "LEAST_WEIGHT": beliefs.LEAST_WEIGHT,
            "SAME_MEAN": beliefs.SAME_MEAN,
            "LEAST_RATIO": math.exp(-beliefs.SAME_SPREAD),
            "MOST_RATIO": math.exp(beliefs.SAME_SPREAD),
            "LOG_REPORTED_ODDS": math.log(beliefs.REPORTED_ODDS),
            "LARGEST": believed.LARGEST,
            "LARGEST_ANGLE": self.arithmetic.largest_angle,
        }

    def _sizes(self) -> dict[str, int]:
        settings, m = self.controller.settings, len(self.controller.space.command)
        nominal, regressions = self.controller.nominal, self.controller.residual.regressions
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
            "BELIEVES": int(self.controller.beliefs is not None),
            "START_COUNT": len(self.controller.beliefs.beliefs) if self.controller.beliefs else 0,
            "FEATURE_DEGREE": features_used(self.controller).degree,
            "WAVES": features_used(self.controller).waves,
            "PROBES": beliefs.PROBES,
            "MOST": beliefs.MOST,
            "YOUNG": beliefs.YOUNG,
            "SUDDEN": beliefs.SUDDEN,
            "ACCIDENTS": beliefs.ACCIDENTS,
            "WIDENINGS": beliefs.WIDENINGS,
            "CURRENT": KINDS.index("current"),
        }

    def _space(self) -> list[str]:
        space, failures = self.controller.space, self.controller.failures
        names = "state_scale", "state_centre", "command_scale", "command_centre", "command_lower", "command_upper"
        arrays = [self._array(name, getattr(space, name)) for name in names]
        arrays.append(self._array("error_scale", np.where(space.tracked, space.error_scale, 0.0)))
        arrays.append(self._array("irrational_steps", irrational_steps(len(space.command))))
        return [*arrays, self._array("failures", failures), f"static const int failure_count = {len(failures)};"]

    def _features(self) -> list[str]:
        used = features_used(self.controller)
        return [self._array("wave_frequency", used.frequencies), self._array("wave_shift", used.shifts)]

    def _beliefs(self) -> list[str]:
        """What is believed at the start: roots column by column, as the transposed matrices row by row."""
        known, sizes = self.controller.beliefs, _Sizes.of(self.controller)
        if known is None:
            names = ("probes", "change", "start_mixture_mean", "start_mixture_covariance", "start_noise", "start_mean")
            others = ("start_root", "start_freedom", "start_squares", "start_log_weight", "start_rate")
            arrays = [self._array(name, np.empty(0)) for name in (*names, *others)]
            counts = [_integers(name, "int", np.empty(0)) for name in ("start_kind", "start_age")]
            return [*arrays, *counts, "#define START_WRONG_ENDS 0", "#define START_RIGHT_ENDS 0"]
        mixture, each, upper = known.mixture(math.nan), known.beliefs, np.triu_indices(sizes.weights)
        lower, count = np.tril_indices(sizes.features), sizes.features
        arrays = {
            "probes": known.probes,
            "change": known.change[:, *upper],
            "start_mixture_mean": mixture.mean[:, :count],
            "start_mixture_covariance": mixture.covariance[:, *lower],
            "start_noise": np.sqrt(mixture.noise),
            "start_mean": np.array([one.weights.mean for one in each]),
            "start_root": np.array([np.swapaxes(one.weights.root, 1, 2)[:, *upper] for one in each]),
            "start_freedom": np.array([one.freedom for one in each]),
            "start_squares": np.array([one.squares for one in each]),
            "start_log_weight": np.array([one.log_weight for one in each]),
            "start_rate": np.array([one.rate for one in each]),
        }
        ends = zip(("START_WRONG_ENDS", "START_RIGHT_ENDS"), known.wrong_measurements, strict=True)
        return [
            *(self._array(name, values) for name, values in arrays.items()),
            _integers("start_kind", "int", np.array([KINDS.index(one.kind) for one in each])),
            _integers("start_age", "int", np.array([one.age for one in each])),
            *(f"#define {name} R({float(value)!r})" for name, value in ends),
        ]

    def _nominal(self) -> str:
        """The nominal map: `centre` and `scale` are those of its inputs."""
        nominal = self.controller.nominal
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
            "typedef struct {\n    int kind, degree, waves, kernel, plug_in, centre_count;\n"
            "    real noise_std, signal;\n"
            "    const real *origin, *scale, *weights, *posterior, *centres, *factor, *slope_scale;\n} regression;"
        )
        arrays, rows = [], []
        for i, each in enumerate(self.controller.residual.regressions):
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
            head = f"WEIGHTED, {regression.degree}, 0, 0, 0, 0, {noise}, {self._literal(1.0)}"
            row = f"{head}, {pointers}, NULL, NULL, NULL"
        elif isinstance(regression, Posterior):
            used = regression.features
            arrays = {
                "origin": regression.data.centre,
                "scale": regression.data.scale,
                "weights": regression.mean_weights,
                "posterior": _triangle(regression.covariance),
            }
            pointers = ", ".join(f"{name}_{each}" for each in arrays)
            scale = self._literal(regression.data.value_scale)
            row = f"WEIGHTED, {used.degree}, {used.waves}, 0, 0, 0, {noise}, {scale}, {pointers}, NULL, NULL, NULL"
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
            row = f"GAUSSIAN_PROCESS, 0, 0, {kernel}, {plug_in}, {count}, {noise}, {signal}, {pointers}"
        else:
            zero = self._literal(0.0)
            return [], f"ZERO, 0, 0, 0, 0, 0, {noise}, {zero}, NULL, NULL, NULL, NULL, NULL, NULL, NULL"
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
