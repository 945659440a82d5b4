"""The training loop: a stopped training, taken up again, ends where an undisturbed one does.

Nothing random is left to chance or to a state that could be lost: the order of an epoch and what is hidden in it follow
from the seed and the epoch's number, the learning rate from the step, and the networks draw nothing after they are
made. So a checkpoint (weights, moving average, optimiser, history), after each epoch and every ten minutes of a long
one, is all there is to keep. What is judged, and kept in the end, is the moving average; training stops when it has not
become better on the validation rooms for `patience` epochs.

The loss is on coefficients and on irradiance at fixed normals, which is what a lit surface shows; a Huber loss, so that
the few lights of a hundred times the mean do not rule the rest. Where places in the sun are among the training rooms
they do even so, and the errors of the many that are nearly right count for nothing. So it can be the logarithm of each
light's error (`is_logarithmic`): what counts is by what factor an error became smaller. The expected error is fitted
to the RMSE that was made, by the likelihood of an exponential distribution, whose best guess is the mean error.
"""

from __future__ import annotations

import copy
import csv
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from xihenet.estimators.base import Target
from xihenet.formats import format_duration
from xihenet.records import ArrayBool, ArrayF64, ArrayInt
from xihenet.training import networks
from xihenet.training.dataset import CloudSet, Content, open_split, read_content
from xihenet.training.networks import Batch
from xihenet.training.rooms import n_rooms_needed, split_of
from xihenet.training.scores import irradiance_table

N_NORMALS = 32
KEEP_EVERY_S = 600.0
Progress = Callable[[str], None]


SMALL_LIGHT = 0.2  # Added to the size of a light; the median of the training rooms has 0.3.
LOGARITHMIC_FROM = 0.1  # Of that size, the error from which halving it counts the same however large it is.
LOGARITHMIC_WEIGHT = 0.15  # Of a logarithmic loss, so that it weighs about as much beside that of the expected error


@dataclass(frozen=True)
class TrainSettings:
    """One training."""

    cache: Path  # sampled clouds, as `xihenet.training.dataset.build_cache` leaves them
    out: Path  # folder of the run: checkpoint.pt, curves.csv, best.pt
    estimator: str = "lattice"  # key of `KINDS`; must fit the cache's sampling
    target: Target = "ldr"
    seed: int = 0  # of the first weights and of the order of the clouds
    epochs: int = 60
    batch_size: int = 64
    learning_rate: float = 2e-3  # the highest; it falls to 0 along a cosine
    weight_decay: float = 0.02
    ema: float = 0.995  # share of the moving average that a step keeps, at most; less in the first steps
    patience: int = 15  # epochs without a better validation error after which training stops
    irradiance_weight: float = 0.5  # of the second part of the loss
    error_weight: float = 0.02  # of the third
    huber_delta: float = 1.0  # difference of coefficients from which the loss is linear
    # The logarithm of each light's error in place of Huber's loss, so that halving any error counts alike.
    is_logarithmic: bool = False
    hidden_share: float = 0.3  # share of the training clouds of which a random cap is hidden, see `hide_caps`
    start: Path | None = None  # weights to begin with, as estimators read them; None for random ones
    start_share: float = 0.0  # of them in the weights that are judged and kept: between both may be better than either
    n_rooms: int | None = None  # train on the clouds of the first rooms alone, for learning curves; None for all
    options: Mapping[str, object] = field(default_factory=dict)  # of the network's architecture
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.target not in ("ldr", "hdr"):
            raise ValueError(f"target: expected 'ldr' or 'hdr', got {self.target!r}")
        if min(self.epochs, self.batch_size, self.patience) < 1 or not 0 <= self.ema < 1:
            raise ValueError("training: expected at least one epoch, cloud and epoch of patience, and 0 <= ema < 1")
        if not 0 <= self.start_share < 1 or (self.start_share and self.start is None):
            raise ValueError("start_share: expected at least 0 and less than 1, and weights to begin with")

    def decisive(self) -> dict[str, str]:
        """What must be the same for a stopped training to be taken up, beside what its clouds were made of."""
        return {name: str(value) for name, value in asdict(self).items() if name not in ("out", "cache", "device")}


@dataclass(eq=False)
class _Run:
    """The state of a training, all of which is in a checkpoint."""

    net: nn.Module
    average: nn.Module
    optimiser: torch.optim.Optimizer
    epoch: int = 0
    n_batches: int = 0  # of the epoch under way that are done
    losses: float = 0.0  # and the sum of their losses
    step: int = 0
    best_rmse: float = float("inf")
    best_epoch: int = 0
    history: list[dict[str, float]] = field(default_factory=list)


STATES = ("net", "average", "optimiser")
"""Parts of a checkpoint that have a state of their own."""

SAID = {
    "rooms": "data", "rooms_digest": "data", "n_anchors": "anchors", "changes_per_pair": "changes",
    "merged_per_position": "merged-clouds", "is_logarithmic": "logarithmic-loss",
}  # fmt: skip
"""Options whose name is not that of the setting."""


def train(settings: TrainSettings, *, stop_after: int | None = None, progress: Progress = lambda line: None) -> Path:
    """Train, or go on with a training that was stopped; the path of the best network's file.

    `stop_after` ends the call after that many epochs as if it had been interrupted. ValueError if the cache is missing,
    a split that is needed is empty, `settings.out` holds a training with other settings, or the loss is no number.
    """
    clouds, held_out = open_split(settings.cache, "train"), open_split(settings.cache, "validation")
    for name, split in (("train", clouds), ("validation", held_out)):
        if not len(split):
            raise ValueError(f"{settings.cache}: the {name} split is empty; more rooms are needed")
    settings.out.mkdir(parents=True, exist_ok=True)
    content = read_content(settings.cache)
    run = _start_or_resume(settings, content)
    # Always saying the training rooms' mean is off by so much on the validation rooms.
    mean = clouds.truth(settings.target).mean(axis=0, dtype=np.float64)
    yardstick = max(float(np.sqrt(np.mean((held_out.truth(settings.target) - mean) ** 2))), 1e-9)
    started, first_epoch = time.monotonic(), run.epoch
    last_epoch = settings.epochs if stop_after is None else min(settings.epochs, first_epoch + stop_after)
    while run.epoch < last_epoch and run.epoch - run.best_epoch < settings.patience:
        loss = _train_epoch(run, clouds, settings, content)
        if not np.isfinite(loss):
            raise ValueError(
                f"{settings.out}: the training diverged in epoch {run.epoch}, where its loss is {loss}: remove the "
                "folder, and train with a lower --learning-rate"
            )
        _judge(run, held_out, settings, loss, yardstick)
        _save_checkpoint(run, settings, content)
        elapsed_s = time.monotonic() - started
        left_s = elapsed_s / (run.epoch - first_epoch) * (settings.epochs - run.epoch)
        ratio = run.history[-1]["validation_ratio"]
        progress(
            f"epoch {run.epoch}/{settings.epochs}  loss {loss:.4f}  validation {ratio:.3f} of the mean predictor's "
            f"(best in epoch {run.best_epoch})  {format_duration(left_s)} left"
        )
    best = settings.out / "best.pt"
    if not best.exists():
        raise ValueError(f"{best} is not there, and its training is done: remove the folder, and train again")
    return best


def check_trainable(settings: TrainSettings, content: Content) -> None:
    """Whether `train` could go on with a cache of that content, which need not be built yet.

    ValueError if its rooms are too few, or `settings.out` holds a training with other settings or on other clouds.
    """
    splits = [split_of((seed, number)) for seed, number in content["rooms"]]
    n_train, n_validation = splits.count("train"), splits.count("validation")
    if not (n_train and n_validation):
        seed = min(seed for seed, _ in content["rooms"])
        raise ValueError(
            f"training: expected rooms of which some train and some validate, got {n_train} and {n_validation}; build "
            f"at least {n_rooms_needed(seed)} rooms of seed {seed}, of all splits, with xihe dataset build"
        )
    if (settings.out / "checkpoint.pt").exists():
        _read_checkpoint(settings, content)


def _read_checkpoint(settings: TrainSettings, content: Content) -> dict[str, Any]:
    path = settings.out / "checkpoint.pt"
    kept = networks.read_torch(path, settings.device)
    pairs = ((kept.get("settings", {}), settings.decisive()), (kept.get("clouds", {}), content))
    other = [name for old, new in pairs for name in old.keys() | new.keys() if old.get(name) != new.get(name)]
    if other:
        said = ", ".join(sorted({SAID.get(name, name.replace("_", "-")) for name in other}))
        raise ValueError(
            f"{path}: expected a training with the same settings, got one with other {said}; choose another --out or "
            "remove the folder"
        )
    return kept


def rows_of_first_rooms(clouds: CloudSet, n_rooms: int | None) -> ArrayInt:
    """Numbers of the clouds of the first `n_rooms` rooms, all for None. ValueError if there are fewer."""
    rooms = np.unique(clouds.room)
    if n_rooms is not None and not 1 <= n_rooms <= len(rooms):
        raise ValueError(f"rooms: expected 1 to {len(rooms)} training rooms, got {n_rooms}")
    return np.flatnonzero(np.isin(clouds.room, rooms[:n_rooms]))


def hide_caps(batch: Batch, share: float, rng: np.random.Generator) -> Batch:
    """Of some clouds, leave only what lies within a random cap, as if a wall had been close to the phone.

    The cap's axis points to anywhere, its half angle leaves 5 to 100 % of the sphere; a cloud that would have nothing
    left stays whole. The light to be found stays the same.
    """
    drawn = _drawn_caps(len(batch.is_set), share, rng)
    axes, chosen, lowest_cosine = (torch.from_numpy(np.float32(part)).to(batch.is_set.device) for part in drawn)
    along = torch.einsum("bnc,bc->bn", nn.functional.normalize(batch.points_m, dim=2), nn.functional.normalize(axes))
    left = batch.is_set & (along >= lowest_cosine[:, None])
    is_set = torch.where((chosen.bool() & left.any(1))[:, None], left, batch.is_set)
    known = is_set[..., None]
    return Batch(batch.srgb * known, batch.points_m * known, is_set, batch.truth, batch.facing * is_set)


def _drawn_caps(n: int, share: float, rng: np.random.Generator) -> tuple[ArrayF64, ArrayBool, ArrayF64]:
    return rng.normal(size=(n, 3)), rng.random(n) < share, 1 - 2 * rng.uniform(0.05, 1.0, n)


def training_loss(light: Tensor, expected_error: Tensor | None, truth: Tensor, settings: TrainSettings) -> Tensor:
    """Scalar; light and truth (B, 9, 3)."""
    if settings.is_logarithmic:
        floor = (LOGARITHMIC_FROM * (_size(truth) + SMALL_LIGHT)).square()
        loss = LOGARITHMIC_WEIGHT * ((light - truth).square().mean((1, 2)) / floor + 1).log().mean()
    else:
        # Over pi: what a white Lambert surface shows.
        to_irradiance = torch.as_tensor((irradiance_table(N_NORMALS) / np.pi).astype(np.float32), device=light.device)
        huber = nn.functional.huber_loss
        loss = huber(light, truth, delta=settings.huber_delta)
        irradiance = huber(to_irradiance @ light, to_irradiance @ truth, delta=settings.huber_delta)
        loss = loss + settings.irradiance_weight * irradiance
    if expected_error is not None:
        made = _size(light.detach() - truth)
        loss = loss + settings.error_weight * (expected_error.log() + made / expected_error).mean()
    return loss


def _size(light: Tensor) -> Tensor:
    """(B,) root mean square of (B, 9, 3)."""
    return light.square().mean((1, 2)).sqrt()


def _start_or_resume(settings: TrainSettings, content: Content) -> _Run:
    torch.manual_seed(settings.seed)
    sizes = {} if settings.start is None else networks.sizes_in(settings.start, settings.estimator)
    options = {**sizes, **networks.options_for(settings.estimator, settings.target), **settings.options}
    net = networks.make_network(settings.estimator, **options).to(settings.device)
    if settings.start is not None:
        networks.take_weights(net, settings.estimator, settings.start)
    # On a GPU a step of a small network is bound by the number of its kernels: one in place of ten per layer.
    optimiser = torch.optim.AdamW(
        net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, foreach=False,
        fused=settings.device != "cpu",
    )  # fmt: skip
    run = _Run(net, copy.deepcopy(net), optimiser)
    if (settings.out / "checkpoint.pt").exists():
        kept = _read_checkpoint(settings, content)
        for name, part in vars(run).items():
            if name in STATES:
                part.load_state_dict(kept[name])
            elif name in kept:
                setattr(run, name, kept[name])
    return run


def _train_epoch(run: _Run, clouds: CloudSet, settings: TrainSettings, content: Content) -> float:
    """One pass, or what is left of it; the mean loss."""
    run.net.train()
    rng = np.random.default_rng([settings.seed, run.epoch])
    order = rng.permutation(rows_of_first_rooms(clouds, settings.n_rooms))
    batches = np.array_split(order, -(-len(order) // settings.batch_size))
    for rows in batches[: run.n_batches]:
        _drawn_caps(len(rows), settings.hidden_share, rng)
    kept_at = time.monotonic()
    for rows in batches[run.n_batches :]:
        for group in run.optimiser.param_groups:
            group["lr"] = _learning_rate(run.step, settings.epochs * len(batches), settings.learning_rate)
        batch = networks.read_batch(clouds, rows, settings.target, settings.device)
        batch = hide_caps(batch, settings.hidden_share, rng)
        light, expected_error = networks.run_network(run.net, batch)
        loss = training_loss(light, expected_error, batch.truth, settings)
        run.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(run.net.parameters(), 1.0)
        run.optimiser.step()
        run.step += 1
        keep = min(settings.ema, (1 + run.step) / (10 + run.step))
        get_ema_multi_avg_fn(keep)(list(run.average.parameters()), list(run.net.parameters()), None)  # type: ignore[no-untyped-call]
        run.losses += float(loss.detach())
        run.n_batches += 1
        if time.monotonic() - kept_at >= KEEP_EVERY_S:
            kept_at = time.monotonic()
            _save_checkpoint(run, settings, content)
    mean_loss = run.losses / len(batches)
    run.epoch, run.n_batches, run.losses = run.epoch + 1, 0, 0.0
    return mean_loss


def _learning_rate(step: int, n_steps: int, highest: float) -> float:
    """A linear rise over the first twentieth, then half a cosine down to 0."""
    rise = max(1, n_steps // 20)
    if step < rise:
        return highest * (step + 1) / rise
    return highest * 0.5 * (1 + float(np.cos(np.pi * (step - rise) / max(1, n_steps - rise))))


def _judge(run: _Run, held_out: CloudSet, settings: TrainSettings, loss: float, yardstick: float) -> None:
    """Validate the moving average, with its share of the start, note it in the history, and keep the best so far."""
    judged_net = run.average
    if settings.start is not None:
        judged_net = copy.deepcopy(run.average)
        networks.take_weights(judged_net, settings.estimator, settings.start, settings.start_share)
    light, _ = networks.predict(judged_net, held_out, settings.target, settings.device)
    rmse = float(np.sqrt(np.mean((light - held_out.truth(settings.target)) ** 2, dtype=np.float64)))
    judged = {"validation_rmse": rmse, "validation_ratio": rmse / yardstick}
    run.history.append({"epoch": run.epoch, "loss": loss, **judged, "rate": run.optimiser.param_groups[0]["lr"]})
    if rmse < run.best_rmse:
        run.best_rmse, run.best_epoch = rmse, run.epoch
        trained = networks.TrainedNetwork(settings.estimator, settings.target, settings.seed, judged_net)
        networks.save_network(settings.out / "best.pt", trained)


def _save_checkpoint(run: _Run, settings: TrainSettings, content: Content) -> None:
    state = {name: part.state_dict() if name in STATES else part for name, part in vars(run).items()}
    deciding = {"settings": settings.decisive(), "clouds": content}
    networks.write_torch(settings.out / "checkpoint.pt", {**deciding, **state})
    if not run.history:
        return
    # From the history and not appended to, so that a resumed training has each epoch once.
    with (settings.out / "curves.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(run.history[0]))
        writer.writeheader()
        writer.writerows(run.history)
