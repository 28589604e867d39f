"""The regression of a tuning, on the features of a model: its maps, and what they predict by folds.

Of emotions that captures show, each control moves as captured or as the base changes it, whichever
predicts clips better from others.
"""

import copy
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.data.clips import Clip, read_known, spread_clips
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.waveforms import read_waveform
from deitalk.emotions import EMOTIONS
from deitalk.evaluation.scores import area_under_curve
from deitalk.evaluation.smoothness import (
    MOVING,
    Example,
    knows_contact,
    lips_together,
    load_example,
    speaking_frames,
)
from deitalk.evaluation.validation import JAW
from deitalk.models.curve_model import Analysis, DEITalk
from deitalk.models.rig_decoder import RigDecoder
from deitalk.training.trainer import Progress, silent
from deitalk.training.tuning.ridge import (
    LEAST_BETTER,
    Capture,
    Maps,
    Rows,
    Sums,
    fit_ridge,
)
from rig.arrays import Bool, Float32, Float64

MOST_SCORED = 40
"""Clips that are predicted from others, of each emotion, evenly spread."""
MOST_SIZED = 20
"""Clips on which contacts, and the size of emotions, are measured, evenly spread."""
MOST_RAISED = 3.0
"""Most by which the spread of a control is raised."""
GAINS = (0.5, 1.5)
"""Range of the size of an actor's expressions over those of the base."""
CALMEST = 0.2
"""Least share to which the jaw's motion by the base's emotions is lowered."""
SHARES = 9
"""Shares of it that are tried."""
TOUCHING = 0.5
"""Captured value of lips-together from which lips touch."""
LEAST_TOUCHING = 30
"""Frames of speech with a contact, and without, from which on captures tell contacts: 1 s."""


def analysed(
    model: DEITalk, clip: Clip, n_frames: int, features: FrozenFeatures | None
) -> Analysis:
    """A clip by a model, from its features where these are known."""
    if features is None:
        sound = read_waveform(clip.audio)
        padded = np.pad(sound, (0, max(n_frames * SAMPLE_RATE // FRAME_RATE - len(sound), 0)))
        return model.analyse(torch.from_numpy(padded), n_frames)
    known = features.features(clip, n_frames)[:n_frames]
    return model.analyse(torch.from_numpy(known.astype(np.float32)), n_frames)


def styles_of_clip(model: DEITalk, clip: Clip, n_frames: int, actor: str = "") -> Tensor:
    """Styles of a clip's emotion and of an actor, the same in all frames [shape=(T, 5 + A)]."""
    emotion = torch.eye(len(EMOTIONS))[EMOTIONS.index(clip.emotion)]
    return model.styles(emotion.expand(n_frames, -1), actor)


def _last_layers(decoder: RigDecoder) -> list[nn.Module]:
    """What a regression changes: the layers that maps are added to, then the change by emotions."""
    layers = (decoder.output, decoder.actor_layers, decoder.change)
    return [layer for layer in layers if layer is not None]


def _states(decoder: RigDecoder) -> list[dict[str, Tensor]]:
    return copy.deepcopy([layer.state_dict() for layer in _last_layers(decoder)])


def _load(decoder: RigDecoder, states: Sequence[dict[str, Tensor]], *, maps: bool = False) -> None:
    """Load `_states`; with `maps` those alone that maps are added to."""
    for layer, state in zip(_last_layers(decoder), states, strict=True):
        if not (maps and layer is decoder.change):
            layer.load_state_dict(state)


def _range(values: Float64 | Float32) -> Float64:
    """Range of curves, but for their ends [shape=(...,)]."""
    high, low = np.percentile(values, (95, 5), axis=-1)
    return np.asarray(high - low)


def _jaw_share(acted: Float64, own: Float32, reference: int) -> tuple[float, Float64]:
    """Share of the base's change of a jaw, and its pose in each emotion, of `size_emotions`.

    From its curves in each emotion [shape=(5, T)], and those of the tuned face [shape=(T,)].
    """
    calm = acted[reference]
    moved, about = acted - calm, calm - calm.mean()
    if calm.std() <= MOVING or own.std() == 0:
        return 1.0, np.zeros(len(acted))
    slope = moved @ about / np.square(about).sum()
    pose = moved.mean(axis=1) - slope * calm.mean()
    most = np.maximum(_range(acted) / _range(calm), 1)
    start = float(np.clip(own.std() / calm.std(), CALMEST, 1))
    for share in np.linspace(start, CALMEST, SHARES).tolist():
        shown = own + pose[:, None] + share * (moved - pose[:, None])
        if start == 1 or (_range(shown) / _range(own) <= most).all():
            break
    return share, pose


class Raised(NamedTuple):
    """Factors on the spread of every control about its mean.

    Attributes
    ----------
    factor, means : ndarray [shape=(A + 1, C)]
        Of a face without a name, then of every actor.
    """

    factor: Float64
    means: Float64

    def of(self, layers: Tensor) -> Tensor:
        """Scale the last layer, then how those of actors differ from it [shape=(A + 1, C, ...)]."""
        factor = torch.from_numpy(self.factor[: len(layers)]).to(layers)
        factor = factor.view(*factor.shape, *[1] * (layers.dim() - 2))
        scaled = factor * torch.cat((layers[:1], layers[:1] + layers[1:]))
        return torch.cat((scaled[:1], scaled[1:] - scaled[:1]))

    def scale(self, decoder: RigDecoder) -> None:
        """Scale the last layers of a decoder about the means, in place."""
        output, layers = decoder.output, decoder.actor_layers
        weights, biases = output.weight[None], output.bias[None]
        if layers is not None:
            biases = torch.cat((biases, layers.bias))
            weights = torch.cat((weights, layers.weight)) if layers.weight.shape[-1] else weights
        about = torch.from_numpy(self.means[: len(biases)]).to(biases)
        about[1:] -= about[:1].clone()
        weights, biases = self.of(weights), self.of(biases - about) + about
        output.weight.copy_(weights[0])
        output.bias.copy_(biases[0])
        if layers is not None:
            layers.bias.copy_(biases[1:])
            if len(weights) > 1:
                layers.weight.copy_(weights[1:])


class Regression:
    """Maps of a model's last layers, fitted on captures.

    Parameters
    ----------
    model : DEITalk
        Its last layers are as they are before the maps.
    base : DEITalk
        Gives the change of emotions.
    clips : sequence of Clip
        To fit on.
    learnt : array [shape=(C,)]
        Controls to fit.
    features : FrozenFeatures or None
        Of the clips; None: their sound is read.
    progress : callable
        As of the trainer.
    new_actors : bool
        As for `fit_ridge`.
    """

    maps: Maps

    def __init__(
        self,
        model: DEITalk,
        base: DEITalk,
        clips: Sequence[Clip],
        learnt: Bool,
        features: FrozenFeatures | None = None,
        progress: Progress = silent,
        *,
        new_actors: bool = True,
    ) -> None:
        self.new_actors = new_actors
        self.model, self.base, self.clips, self.learnt = model, base, clips, learnt
        self.features, self.progress, self.controls = features, progress, model.controls
        self.raised: Raised | None = None
        """Factors of the spread; None: as regressed."""
        self.start = _states(model.rig_decoder)
        self.places = {clip.name: place for place, clip in enumerate(clips)}
        self.last: tuple[str, Analysis] | None = None
        """Clip that was decoded last, and its analysis."""

    def fit(self, late: Sequence[Clip] = (), *, may_stay: bool = False) -> Maps | None:
        """Fit the maps; return what further clips add to them, if there are any."""
        sums: dict[tuple[int, ...], Sums] = {}
        self.maps = self._maps(self.clips, sums, may_stay)
        if not late:
            return None
        whole = self._maps([*self.clips, *late], sums, may_stay)
        return Maps(whole.weight - self.maps.weight, whole.bias - self.maps.bias, whole.stays)

    def _maps(
        self, clips: Sequence[Clip], sums: dict[tuple[int, ...], Sums], may_stay: bool
    ) -> Maps:
        """What a ridge regression on clips adds to the last layers."""
        captures = [
            Capture(
                clip.take_name, clip.speaker, read_known(clip.known, self.controls), clip.emotion
            )
            for clip in clips
        ]

        def read(place: int) -> Rows:
            self.progress(0, 1, {"fitted": (place + 1) / len(clips)})
            return self._rows(clips[place])

        actors = self.model.actors
        return fit_ridge(
            captures,
            read,
            actors,
            self.learnt,
            sums,
            may_stay=may_stay,
            new_actors=self.new_actors,
        )

    @torch.no_grad()
    def contacts_are_base(self) -> bool:
        """Whether the base tells captured contacts of the lips as well as the maps of other clips.

        By the area under the curve of frames of speech whose lips touch against the others, because
        a regression is nearer to soft contacts than phones that are heard, and shuts fewer lips.
        """
        touches, found, of_base = list[Float32](), list[Float32](), list[Float32]()
        for clip in spread_clips(list(self.clips), MOST_SIZED):
            example = load_example(clip, self.controls)
            speaks = speaking_frames(example)
            if not knows_contact(example.known, self.controls) or not speaks.any():
                continue
            analysis = analysed(self.base, clip, len(example.curves), self.features)
            styles = styles_of_clip(self.base, clip, len(example.curves))
            calm = torch.eye(len(EMOTIONS))[0].expand(len(styles), -1)
            both = self.base.decode(analysis, torch.stack((self.base.styles(calm, ""), styles)))
            assert self.base.lips is not None and analysis.lips is not None
            heard = self.base.lips.correct(both, analysis.lips)[1].numpy()
            every = example.curves, self.predicted(clip, example), heard
            for rows, curves in zip((touches, found, of_base), every, strict=True):
                rows.append(lips_together(curves, self.controls)[speaks])
        if not touches:
            return True
        shut = np.concatenate(touches) >= TOUCHING
        if min(shut.sum(), (~shut).sum()) < LEAST_TOUCHING:
            return True
        own, base = (
            area_under_curve(values[shut], values[~shut])
            for values in (np.concatenate(found), np.concatenate(of_base))
        )
        return bool(own < base + LEAST_BETTER)

    @torch.no_grad()
    def teach_emotions(self, *, scales: bool) -> float:
        """Choose by control whether a captured emotion moves as captured or as the base's change.

        What predicts clips from others better, by folds; the maps must be in the model.

        Parameters
        ----------
        scales : bool
            Give the base's change the size of the captured ones first.

        Returns
        -------
        float
            The factor of the change.
        """
        decoder = self.model.rig_decoder
        change = decoder.change
        if change is None or decoder.kept is None:
            return 1.0
        acted = [c for c in self.clips if EMOTIONS.index(c.emotion) != change.reference]
        if not acted or not any(EMOTIONS.index(c.emotion) == change.reference for c in self.clips):
            return 1.0
        gain = self._gain(acted) if scales else 1.0
        change.carry.mul_(gain)
        groups = Counter(clip.emotion for clip in acted)
        untaught: dict[int, Tensor] = {}
        for emotion in [name for name, count in groups.items() if count > 1 and self.maps.held]:
            errors = np.zeros((2, len(self.controls)))
            clips = [clip for clip in acted if clip.emotion == emotion]
            for clip in spread_clips(clips, MOST_SCORED):
                example = load_example(clip, self.controls, sound=False)
                for place, share in enumerate((1.0, 0.0)):
                    change.teach(torch.full_like(change.taught, share))
                    found = self.predicted(clip, example)
                    errors[place] += np.square(found - example.curves).sum(axis=0) * example.known
            worse = torch.from_numpy((errors[0] > errors[1]) & self.learnt)
            untaught[EMOTIONS.index(emotion)] = worse
        taught = torch.ones_like(change.taught)
        for place, worse in untaught.items():
            taught[place, worse] = 0.0
        change.teach(taught)
        return gain

    def _gain(self, acted: Sequence[Clip]) -> float:
        """Size of the captured changes by emotion over those of the base, within `GAINS`."""
        change = self.model.rig_decoder.change
        assert change is not None
        reference = EMOTIONS[change.reference]
        calm = [clip for clip in self.clips if clip.emotion == reference]
        still = self._means(calm)[0]
        along, size = 0.0, 0.0
        for emotion in dict.fromkeys(clip.emotion for clip in acted):
            clips = [clip for clip in acted if clip.emotion == emotion]
            shown, of_base = self._means(clips)
            counts = self.learnt & np.isfinite(shown - still) & np.isfinite(of_base)
            along += float(((shown - still) * of_base)[counts].sum())
            size += float(np.square(of_base[counts]).sum())
        if size < MOVING**2:
            return 1.0
        return float(np.clip(along / size, *GAINS))

    def _means(self, clips: Sequence[Clip]) -> tuple[Float64, Float64]:
        """Mean captured curves, and mean change of the base's by the emotion [shape=(C,)]."""
        decoder = self.model.rig_decoder
        assert decoder.change is not None
        count, shown, changed = (np.zeros(len(self.controls)) for _ in range(3))
        for clip in spread_clips(list(clips), MOST_SCORED):
            example = load_example(clip, self.controls, sound=False)
            analysis = analysed(self.base, clip, len(example.curves), self.features)
            emotion = styles_of_clip(self.base, clip, len(example.curves))
            readings = torch.stack((decoder.change.plain(emotion), emotion))
            calm, acted = self.base.decode(analysis, readings)
            change = ((acted - calm) @ decoder.change.carry.T).numpy()
            count += len(example.curves) * example.known
            shown += example.curves.sum(axis=0) * example.known
            changed += change.sum(axis=0) * example.known
        with np.errstate(invalid="ignore", divide="ignore"):
            return shown / count, changed / count

    @torch.no_grad()
    def size_emotions(self) -> None:
        """Lower the base's change of the jaw where the actors open it less in speech than the base.

        An emotion changes how far the jaw opens with the speech; added whole to an actor who hardly
        opens it, that would be most of its motion. It is lowered to the actors' spread over that of
        the base, and on until no emotion widens the range of the jaw more than that of the base;
        but for its pose: what an emotion adds where the base's neutral jaw is at rest.
        """
        change, names = self.model.rig_decoder.change, self.base.controls.names
        if change is None or self.model.rig_decoder.kept is None or JAW not in names:
            return
        shares = change.carry.abs().numpy()
        jaw = self.learnt & (shares.max(axis=1) > 0)
        jaw &= shares.argmax(axis=1) == names.index(JAW)
        calm = [clip for clip in self.clips if EMOTIONS.index(clip.emotion) == change.reference]
        rows, owns = [], []
        for clip in spread_clips(calm, MOST_SIZED):
            example = load_example(clip, self.controls, sound=False)
            count = len(example.curves)
            analysis = analysed(self.base, clip, count, self.features)
            every = torch.eye(len(EMOTIONS))[:, None].expand(-1, count, -1)
            of_base = self.base.decode(analysis, self.base.styles(every, ""))
            carried = (of_base @ change.carry.T).numpy().astype(np.float64)
            styles = styles_of_clip(self.model, clip, count, clip.speaker)
            own = self.model.decode(analysed(self.model, clip, count, self.features), styles)
            rows.append(carried[..., jaw])
            owns.append(own.numpy()[:, jaw])
        found, own_jaw = np.concatenate(rows, axis=1), np.concatenate(owns)
        for place, acted, calm_jaw in zip(
            np.flatnonzero(jaw).tolist(), found.transpose(2, 0, 1), own_jaw.T, strict=True
        ):
            share, pose = _jaw_share(acted, calm_jaw, change.reference)
            change.pose[:, place] = torch.from_numpy((1 - share) * pose)
            change.carry[place] *= share

    @torch.no_grad()
    def match_range(self, share: float) -> None:
        """Raise the spread of every learnt control to a share of the captured one, in every style.

        The factors are those of clips that are predicted from others, at most `MOST_RAISED`; of a
        face without a name, and of actors that have offsets alone, those of all clips.
        """
        actors, layers = self.model.actors, self.model.rig_decoder.actor_layers
        captured, found, means, count = np.zeros((4, len(actors) + 1, len(self.controls)))
        for clip in spread_clips(list(self.clips), MOST_SCORED):
            example = load_example(clip, self.controls, sound=False)
            curves = self.predicted(clip, example)
            places = [0, *(k for k, name in enumerate(actors, 1) if name == clip.speaker)]
            frames = len(curves) * example.known
            captured[places] += example.curves.var(axis=0) * frames
            found[places] += curves.var(axis=0) * frames
            means[places] += example.curves.mean(axis=0) * frames
            count[places] += frames
        raised = share * np.sqrt(captured / np.maximum(found, 1e-12))
        factor = np.where(self.learnt & (found > 0), np.clip(raised, 1, MOST_RAISED), 1.0)
        is_shared = layers is not None and not layers.weight.shape[-1]
        factor = np.where(is_shared | ~count.any(axis=1, keepdims=True), factor[0], factor)
        means /= np.maximum(count, 1)
        means = np.where(count > 0, means, means[0])
        self.raised = Raised(factor, means)
        self.raised.scale(self.model.rig_decoder)

    @torch.no_grad()
    def predicted(self, clip: Clip, example: Example) -> Float32:
        """Curves of a clip by the model of the other folds, within the controls' ranges."""
        decoder = self.model.rig_decoder
        now = _states(decoder)
        if self.maps.held:
            _load(decoder, self.start, maps=True)
            self.maps.held[self.maps.folds[self.places[clip.name]]].add_to(decoder)
            if self.raised is not None:
                self.raised.scale(decoder)
        curves = self._decoded(clip, example)
        _load(decoder, now)
        return curves

    @torch.no_grad()
    def before(self, clip: Clip, example: Example) -> Float32:
        """Curves of a clip by the model without the maps, within the controls' ranges."""
        decoder = self.model.rig_decoder
        now = _states(decoder)
        _load(decoder, self.start)
        curves = self._decoded(clip, example)
        _load(decoder, now)
        return curves

    def _decoded(self, clip: Clip, example: Example) -> Float32:
        model, count = self.model.eval(), len(example.curves)
        if self.last is None or self.last[0] != clip.name:
            self.last = clip.name, analysed(model, clip, count, self.features)
        styles = styles_of_clip(model, clip, count, clip.speaker)
        curves = model.decode(self.last[1], styles).numpy()
        within: Float32 = np.clip(curves, self.controls.minimum, self.controls.maximum)
        return within

    @torch.no_grad()
    def _rows(self, clip: Clip) -> Rows:
        """A clip as the last layer is given it, and what is missing in the curves."""
        model = self.model.eval()
        example = load_example(clip, self.controls, sound=False)
        analysis = analysed(model, clip, len(example.curves), self.features)
        style = styles_of_clip(model, clip, len(example.curves), clip.speaker)
        hidden = model.describe(analysis, style)
        given = model.rig_decoder.curves(hidden[None], style[None])[0]
        return hidden.numpy(), example.curves - given.numpy()
