"""Stages of the pass one by one, on arrays of one stream (T, C); what changes, changes in place."""

import numpy as np
import torch

from deitalk.config.rules import RulesConfig
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.curve_pass import CurvePass
from deitalk.postprocess.curve_stages import Near
from deitalk.postprocess.factors import LEAST_PREDICTED
from deitalk.postprocess.known_phones import phone_tracks
from deitalk.postprocess.tracks import N_VARIANTS, shown_columns


class Stages(ControlGroups):
    """Stages of a `CurvePass`."""

    def __init__(self, controls, rules=RulesConfig()):
        super().__init__(controls)
        self.rules = CurvePass(controls, rules)

    def blend(self, neutral, emotional, scale):
        rows = both(neutral, emotional)
        closed = self.rules.closure(rows[..., self.seals])
        blended = self.rules.blend(rows, 1 - closed[:, :, :1], track(scale))
        return blended[0, :, 1].numpy()

    def express(self, curves, neutral, weights, scale, held, variants=None, side=1.0):
        closure = self.rules.closure
        free = 1 - closure(both(neutral, curves)[..., self.seals])[:, :, :1]
        near = self.windows(neutral[:, self.seals])
        closing = self.rules.closing(closure(near.transpose(-1, -2)))
        least = np.maximum(held, LEAST_PREDICTED)
        strength, missing = track(scale * least)[..., 0], track(scale * (least - held))[..., 0]
        emotion = torch.from_numpy(weights)[None]
        slow = 1 - closing[None, :, None]
        variants = np.zeros((len(weights), N_VARIANTS)) if variants is None else variants
        rows = np.concatenate((weights, variants), axis=1)
        ways = torch.from_numpy(np.concatenate((rows, side * rows), axis=1, dtype=np.float32))
        read, spoken = both(neutral, curves), torch.ones_like(slow)
        shown = self.rules.express(read, ways[None], emotion, strength, missing, free, slow, spoken)
        curves[:] = shown[0, :, 1].numpy()

    def rest_lips(self, curves, neutral):
        found = self.rules.rest_lips(both(neutral, curves))[0].numpy()
        neutral[:], curves[:] = found[:, 0], found[:, 1]

    def sharpen_contacts(self, curves):
        sharp = self.rules.sharpen(self.windows(curves[:, self.seals]))
        curves[:, self.seals] = self.rules.around.middle(sharp).numpy()

    def limit_contact_speed(self, curves):
        limited = self.rules.limit_speed(self.windows(curves[:, self.seals]))
        curves[:, self.seals] = limited.numpy()

    def tongue_out(self, curves):
        rows, near = both(curves, curves), self.windows(curves[:, self.tongue])[None, :, None]
        free = 1 - self.rules.closure(rows[..., self.seals])
        curves[:] = self.rules.tongue_out(rows, near, free)[0, :, 0].numpy()

    def scale_opening(self, curves, factor, felt=0.0, intensity=0.0):
        """Curves by the factor, in place; of an emotion, those that are shown."""
        rows = both(curves, curves)
        closed = self.rules.closure(rows[:, :, :1, self.seals])
        felt, shown = (track(np.broadcast_to(x, len(curves))) for x in (felt, intensity))
        found = self.rules.open_mouth(rows, 1 - closed, track(factor), felt, shown[..., 0])[0]
        curves[:] = found[:, 0].numpy()
        return found[:, 1].numpy()

    def rest_in_silence(self, curves, neutral, mouth, expression):
        found = self.rules.gate(both(neutral, curves), track(mouth), track(expression))[0].numpy()
        neutral[:], curves[:] = found[:, 0], found[:, 1]

    def apply_dead_zone(self, curves):
        curves[:] = self.rules.quieten(both(curves, curves))[0, :, 0].numpy()

    def meet_phones(self, curves, phones):
        tracks = torch.from_numpy(phone_tracks(phones, len(curves)))[None, :, None, None]
        contacts = torch.from_numpy(curves[None, :, None, self.seals, None])
        near = Near(contacts, contacts, tracks[..., 0:1], tracks[..., 1:2], contacts)
        met = self.rules.meet_phones.close(contacts, near)[..., 0]
        rows = self.rules.seals.put(both(curves, curves)[:, :, :1], met)
        added = self.rules.closure(met) - self.rules.closure(contacts[..., 0])
        found = self.rules.meet_phones(rows, added, tracks[..., 2], tracks[..., 3])
        curves[:] = found[0, :, 0].numpy()

    def play(self, curves, neutral, motion, spoken=1.0):
        """Motion tracks on the face that is shown, and on the neutral one."""
        gate = np.full(len(curves), spoken, np.float32)
        columns = torch.from_numpy(shown_columns(gate, gate, motion))[None]
        mouth, moved = columns[..., :1], columns[..., 2:]
        found = self.rules.play(both(neutral, curves), moved, mouth)[0].numpy()
        neutral[:], curves[:] = found[:, 0], found[:, 1]

    def windows(self, rows):
        """Rows (T, K) around each frame [shape=(T, K, W)], of zeros beyond the ends."""
        behind, ahead = self.rules.behind, self.rules.ahead
        padded = np.pad(rows, ((behind, ahead), (0, 0)))
        around = np.lib.stride_tricks.sliding_window_view(padded, behind + ahead + 1, axis=0)
        return torch.from_numpy(around.astype(np.float32))


def both(neutral, shown):
    """Two readings (T, C) as the stages take them [shape=(1, T, 2, C)]."""
    return torch.from_numpy(np.stack((neutral, shown), axis=1).astype(np.float32))[None]


def track(values):
    """A track (T,) as the stages take it [shape=(1, T, 1, 1)]."""
    return torch.from_numpy(np.asarray(values, np.float32))[None, :, None, None]
