"""dynamax's hidden Markov models on trajectories of any length, from many starts at once.

dynamax wants sequences of one length. Shorter ones are padded by frames that were not observed: their
likelihood is 1 in every state and they have no part in the maximisation, so that every step still raises the
likelihood of what was observed.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from dynamax.hidden_markov_model import CategoricalRegressionHMM, LinearAutoregressiveHMM, LinearRegressionHMM
from dynamax.hidden_markov_model.inference import HMMPosterior, hmm_posterior_mode
from dynamax.hidden_markov_model.models.arhmm import LinearAutoregressiveHMMEmissions
from dynamax.hidden_markov_model.models.categorical_glm_hmm import CategoricalRegressionHMMEmissions
from dynamax.hidden_markov_model.models.linreg_hmm import LinearRegressionHMMEmissions

__all__ = ["autoregression", "linear_regression", "regression"]

RIDGE = 1.0  # frames' worth of weight that says a linear model's weights are 0; variances are 1
NOBODY = 1e-3  # frames that a state without any still has
ASCENT = {"m_step_optimizer": optax.adam(0.05), "m_step_num_iters": 20}


class _Padded:
    """Emissions whose last input says whether a frame was observed, 1, or is padding, 0."""

    def _compute_conditional_logliks(self, params: Any, emissions: Any, inputs: Any = None) -> Any:
        found = super()._compute_conditional_logliks(params, emissions, inputs[:, :-1])  # type: ignore[misc]
        return found * inputs[:, -1:]


class _Masked:
    """A model whose inputs have one column more, that of `_Padded`."""

    @property
    def inputs_shape(self) -> tuple[int]:
        """Of one frame."""
        return (super().inputs_shape[0] + 1,)  # type: ignore[misc]


class _Floored:
    """Linear regressions whose variances are `floor` at least; dynamax has no prior of its own for them.

    A state whose emissions are constant, or an exact function of its inputs, would have an infinite
    likelihood. With a floor the weights are those of a ridge regression, too, and a state may lose all its
    frames.
    """

    floor = 0.0

    def m_step(self, params: Any, props: Any, batch_stats: Any, m_step_state: Any) -> Any:
        if self.floor:
            total = dict(batch_stats)
            share = 1 / len(total["sum_w"])  # of one trajectory: they are added up
            inputs, outputs = (jnp.eye(total[name].shape[-1]) for name in ("sum_xxT", "sum_yyT"))
            total["sum_w"] = total["sum_w"] + NOBODY * share
            total["sum_xxT"] = total["sum_xxT"] + RIDGE * share * inputs
            total["sum_yyT"] = total["sum_yyT"] + self.floor * total["sum_w"][..., None, None] * outputs
            batch_stats = total
        return super().m_step(params, props, batch_stats, m_step_state)  # type: ignore[misc]


class _Observed:
    """Linear regressions that count the frames that were observed."""

    def collect_suff_stats(self, params: Any, posterior: Any, emissions: Any, inputs: Any = None) -> Any:
        observed = posterior._replace(smoothed_probs=posterior.smoothed_probs * inputs[:, -1:])
        return super().collect_suff_stats(params, observed, emissions, inputs[:, :-1])  # type: ignore[misc]


class _AutoregressionEmissions(_Floored, _Observed, _Padded, LinearAutoregressiveHMMEmissions):
    pass


class _LinearEmissions(_Floored, _Observed, _Padded, LinearRegressionHMMEmissions):
    pass


class _RegressionEmissions(_Padded, CategoricalRegressionHMMEmissions):
    def log_prior(self, params: Any) -> Any:
        """Ridge regression: without it, what can be separated gets infinite weights."""
        return -0.5 * (params.weights**2).sum()


class _Autoregression(_Masked, LinearAutoregressiveHMM):
    pass


class _Regression(_Masked, CategoricalRegressionHMM):
    pass


class _LinearRegression(_Masked, LinearRegressionHMM):
    pass


def autoregression(
    values: np.ndarray,
    lengths: np.ndarray,
    starts: Sequence[np.ndarray],
    transition: np.ndarray,
    steps: int,
    floor: float = 0.0,
) -> np.ndarray | None:
    """Likeliest states of a LinearAutoregressiveHMM of lag 1, or None where every start fails.

    Args:
        values: [frames, columns]; the value before a trajectory's first is 0.
        lengths: frames of every trajectory.
        starts: labels [frames] to start from.
        transition: probabilities [states, states] to start from.
        steps: of expectation maximisation.
        floor: added to every variance.
    """
    before = np.vstack([np.zeros_like(values[:1]), values[:-1]])
    before[np.cumsum(lengths)[:-1]] = 0
    fit = _autoregressive_model(len(transition), values.shape[1], steps, floor)
    return _likeliest(fit, values, before, lengths, starts, transition)


def regression(
    values: np.ndarray,
    actions: np.ndarray,
    lengths: np.ndarray,
    starts: Sequence[np.ndarray],
    transition: np.ndarray,
    steps: int,
) -> np.ndarray | None:
    """Likewise, of a CategoricalRegressionHMM of actions 0..M-1 [frames] given values."""
    fit = _regression_model(len(transition), int(actions.max()) + 1, values.shape[1], steps)
    return _likeliest(fit, actions, values, lengths, starts, transition)


def linear_regression(
    values: np.ndarray,
    actions: np.ndarray,
    lengths: np.ndarray,
    starts: Sequence[np.ndarray],
    transition: np.ndarray,
    steps: int,
    floor: float,
) -> np.ndarray | None:
    """Likewise, of a LinearRegressionHMM of vectors [frames, dimensions] given values.

    Where actions have no dimension, as where none of theirs varies, there is nothing to explain: None.
    """
    if not actions.shape[1]:
        return None
    fit = _linear_model(len(transition), values.shape[1], actions.shape[1], steps, floor)
    return _likeliest(fit, actions, values, lengths, starts, transition)


@functools.cache
def _autoregressive_model(states: int, columns: int, steps: int, floor: float = 0.0) -> Callable:
    model = _Autoregression(states, columns)
    model.emission_component = _AutoregressionEmissions(states, columns)
    model.emission_component.floor = floor
    return _fit(model, steps)


@functools.cache
def _linear_model(states: int, columns: int, dimensions: int, steps: int, floor: float) -> Callable:
    model = _LinearRegression(states, columns, dimensions)
    model.emission_component = _LinearEmissions(states, columns, dimensions)
    model.emission_component.floor = floor
    return _fit(model, steps)


@functools.cache
def _regression_model(states: int, classes: int, columns: int, steps: int) -> Callable:
    model = _Regression(states, classes, columns)
    model.emission_component = _RegressionEmissions(states, classes, columns, **ASCENT)
    return _fit(model, steps)


def _fit(model: Any, steps: int) -> Callable:
    """A compiled function: Viterbi's labels and the log-likelihood after `steps` from every start."""

    def fit(held: Any, emissions: Any, inputs: Any, transition: Any) -> tuple[Any, Any]:
        params, props = model.initialize(jax.random.key(0), transition_matrix=transition)
        part = model.emission_component

        def statistics(states: Any, emission: Any, given: Any) -> Any:
            certain = HMMPosterior(0.0, states, states, states, states[0])
            return part.collect_suff_stats(params.emissions, certain, emission, given)

        def decode(emission: Any, given: Any) -> Any:
            initial, moves, scores = model._inference_args(params, emission, given)
            free = jnp.where(given[1:, -1, None, None] > 0, moves, 1.0)  # to padding costs nothing
            return hmm_posterior_mode(initial, free, scores)

        state = part.initialize_m_step_state(params.emissions, props.emissions)
        counted = jax.vmap(statistics)(held, emissions, inputs)
        started, _ = part.m_step(params.emissions, props.emissions, counted, state)
        params = params._replace(emissions=started)
        params, rising = model.fit_em(params, props, emissions, inputs, num_iters=steps, verbose=False)
        return jax.vmap(decode)(emissions, inputs), rising[-1]

    return jax.jit(jax.vmap(fit, in_axes=(0, None, None, None)))


def _likeliest(
    fit: Callable,
    emissions: np.ndarray,
    inputs: np.ndarray,
    lengths: np.ndarray,
    starts: Sequence[np.ndarray],
    transition: np.ndarray,
) -> np.ndarray | None:
    """The labels under the parameters of largest likelihood; None where no likelihood is a number."""
    padded = functools.partial(_padded, lengths=lengths)
    given = padded(np.hstack([inputs, np.ones((len(inputs), 1))]))
    held = np.stack([padded(np.eye(len(transition))[start]) for start in starts])
    with jax.enable_x64(True):
        labels, likelihoods = (np.asarray(part) for part in fit(held, padded(emissions), given, transition))
    if not np.isfinite(likelihoods).any():
        return None
    best = labels[np.where(np.isfinite(likelihoods), likelihoods, -np.inf).argmax()]
    return best[given[:, :, -1] > 0].astype(np.int64)


def _padded(values: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """[trajectories, longest, ...] of [frames, ...], zeros where a trajectory has ended."""
    result = np.zeros((len(lengths), int(lengths.max()), *values.shape[1:]), values.dtype)
    for row, part in zip(result, np.split(values, np.cumsum(lengths)[:-1]), strict=True):
        row[: len(part)] = part
    return result
