"""Portable controllers of every kind, from random numbers."""

import numpy as np

from stepgap.control.settings import ALL_RULES
from stepgap.export.controller.portable_controller import PortableController
from stepgap.gauss.features import Features
from stepgap.gauss.gaussian_process import HyperParameters, condition_sparse
from stepgap.learning.beliefs import Beliefs, Observed
from stepgap.learning.entry_points import load_residual_model
from stepgap.learning.first_beliefs import Family
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.polynomial import Polynomial
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.regression import Regression, TrainingData
from stepgap.learning.residual import Residual, no_residual
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import Samples, SurrogateMap, exponents_of
from stepgap.step import Array, Quantity, StepSpace, StepStatus

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.52, 0.64)),
    (Quantity("fx", "N", -30.0, 30.0), Quantity("fy", "N", -20.0, 20.0)),
)
CENTRE = np.concatenate([SPACE.state_centre, SPACE.command_centre])
SCALE = np.concatenate([SPACE.state_scale, SPACE.command_scale])
KINDS = ("none", "posterior", "quadratic", "gp", "gp_on_linear", "fitrgp")


def surrogate(rng: np.random.Generator, *, failing: bool) -> SurrogateMap:
    """A polynomial of degree 3 with random weights; if wanted, with regions where steps fail."""
    degrees = exponents_of(4, 3)
    decay = 0.1 ** degrees.sum(axis=1)[:, None]
    weights = SPACE.state_centre * (degrees.sum(axis=1)[:, None] == 0) + decay * rng.normal(size=(len(degrees), 2))
    points = rng.uniform(-1, 1, (64 if failing else 0, 4))
    status = np.where(points[:, 0] > 0.6, int(StepStatus.FELL), int(StepStatus.OK))
    status[points[:, 1] < -0.7] = int(StepStatus.NO_TAKE_OFF)
    scale = SCALE * [1.25, 1.25, 1, 1]
    samples = Samples(points, np.full((len(points), 2), np.nan), status)
    return SurrogateMap(SPACE, CENTRE, scale, 3, weights, np.full(2, 1e-3), samples)


def affine(rng: np.random.Generator) -> AffineMap:
    return AffineMap(
        SPACE, SPACE.state_centre, SPACE.command_centre, SPACE.state_centre, 0.01 * rng.normal(size=(2, 4))
    )


def regression(kind: str, scale: float, rng: np.random.Generator) -> Regression:
    points = CENTRE + SCALE * rng.uniform(-1, 1, (40, 4))
    values = 0.1 * scale * (np.sin(3 * (points - CENTRE) / SCALE).sum(axis=1) + 0.1 * rng.normal(size=40))
    if kind == "quadratic":
        return Polynomial(TrainingData(points, values, CENTRE, SCALE, scale), 2)
    if kind == "posterior":
        return POSTERIOR.fit(TrainingData(points, values, CENTRE, SCALE, scale))
    slope_std = 0.05 * scale if kind == "gp_on_linear" else 0.0
    found = HyperParameters(np.array([0.9, 1.3, 2.0, 0.7]), 0.2 * scale, 0.02 * scale, slope_std)
    process = condition_sparse(points, values, SCALE, found, points[:15])
    return GaussianProcessRegression(process, plug_in=kind == "fitrgp")


def beliefs_about(noise: Array | None, rng: np.random.Generator, *, degree: int = 2, waves: int = 6) -> Beliefs:
    """Beliefs that have seen some steps of a robot whose errors are small; about a fitted residual if it has noise."""
    features = Features.drawn(4, degree, waves, 2.0, np.random.default_rng(0))
    size = features.monomials
    family = Family(0.05 * rng.normal(size=(2, size)), np.tile(0.01 * np.eye(size), (2, 1, 1)), np.full(2, 0.05))
    beliefs = Beliefs.start(features, (2, 2), [] if noise is not None else [family], noise)
    for point in rng.uniform(-0.8, 0.8, (12, 4)):
        error = 0.05 * point[:2] + 0.03 * rng.normal(size=2) + ([0.0, 0.0] if noise is not None else [0.1, -0.1])
        beliefs = beliefs.after(Observed(point, error, 0.3, point[2:], lambda _: None))
    return beliefs.redeployed()


def learned(
    kind: str, *, failing: bool = False, linear: bool = False, seed: int = 0, drift: bool = True, degree: int = 1
) -> PortableController:
    """A controller with a residual of this kind; `posterior` has beliefs alone, or without drift a regression."""
    rng = np.random.default_rng(seed)
    nominal = affine(rng) if linear else surrogate(rng, failing=failing)
    residual, noise = no_residual(2, 2), None
    if kind != "none" and (kind != "posterior" or not drift):
        parts = tuple(regression(kind, scale, rng) for scale in SPACE.state_scale)
        residual = Residual(load_residual_model(kind), parts, 2)
        noise = residual.noise_std / SPACE.state_scale
    failures = CENTRE + SCALE * rng.uniform(-1, 1, (2, 4))
    beliefs = beliefs_about(noise, rng, degree=degree) if drift and kind != "none" else None
    return PortableController(nominal, residual, beliefs, failures, ALL_RULES)


def steps(count: int, spread: float = 1.6, seed: int = 1) -> tuple[Array, Array]:
    """Random states within `spread` half ranges of the centre, so also outside of the ranges, and commands."""
    rng = np.random.default_rng(seed)
    point = CENTRE + SCALE * rng.uniform(-1, 1, (count, 4)) * [spread, spread, 1, 1]
    return point[:, :2], point[:, 2:]
