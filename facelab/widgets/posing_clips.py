"""Time in the posing lab: a clip of key poses, and recorded takes with the pose on top."""

import time
from dataclasses import replace
from types import SimpleNamespace

import ipywidgets as widgets
import numpy as np

from facelab.posing.clips import Clip
from facelab.widgets.lab import WIDTH, Panel, button, row
from facelab.widgets.pace import Pace
from facelab.widgets.page import markup, quiet, shows_errors
from facelab.widgets.parts import ItemList, Track
from facelab.widgets.put_back import PutBack

_FPS = 25  # no more frames than this are sent to the page
_KEYS = "key poses"
_ON_KEYS = (
    "A frame of the clip is on screen, your pose is not: 'Key here' takes the frame, and 'Back to "
    "the pose' shows the pose again."
)
_ON_TAKE = (
    "The model plays the take, and the pose is added to every frame: drag the face to edit all of "
    "it."
)
OTHER_MODEL = "the key poses are of another model; choose that model first."
_SILENT = 60  # s after which a page that has not answered is taken to be gone


class ClipPanel(Panel):
    """Play and scrub through key poses, or through a take that the model performs.

    Attributes
    ----------
    clip : Clip or None
        The key poses, of the model in `model`.
    frame : callable or None
        Gives the vertices of the moment on the slider, while it is shown.
    over_pose : bool
        Whether that follows the pose: a take is shown with the pose as an offset on it.
    """

    def _build(self):
        self.clip = self.model = self.frame = None
        self._tracks, self._halted = {}, -np.inf
        self.source = widgets.Dropdown(
            options=[_KEYS, *self.lab.takes], description="show", layout={"width": WIDTH}
        )
        self.play = widgets.Play(interval=1000 // _FPS, max=3 * _FPS)
        self.slider = widgets.IntSlider(
            max=3 * _FPS, readout=False, description="at",
            layout={"width": "46%"}, style={"description_width": "18px"},
        )  # fmt: skip
        self._link = widgets.jslink((self.play, "value"), (self.slider, "value"))
        self._pace = Pace(self.slider, every=1000 // _FPS)
        self._time = widgets.Label(layout={"width": "52px"})
        self.track = Track(self._on_track)
        self.key = button("Key here", "Make the pose on screen a key at this moment", self._press)
        self.length = widgets.BoundedFloatText(
            3, min=0.2, max=600, step=0.5, description="seconds", layout={"width": "38%"}
        )
        self.easing = widgets.Dropdown(
            options=["smooth", "linear"], layout={"width": "90px"}, tooltip="Between the keys"
        )
        empty = "Pose the face, then press 'Key here'."
        self.keys = ItemList("choice", self._react, empty, label="Key poses")
        self.keys.layout.max_height = "110px"
        self.back = PutBack(self._put_back)
        self._key_box = widgets.VBox(
            [self.track, row(self.key, self.length, self.easing), self.keys, self.back.widget]
        )
        self.pose_it = button(
            "Pose this frame", "Make the frame on the slider the pose", self._press
        )
        self.stop = button("Back to the pose", "Show the pose again", self._press)
        self._about = widgets.HTML()
        self.source.style.description_width = self.length.style.description_width = "56px"
        self.widget = widgets.VBox(
            [
                self.source,
                widgets.HBox([self.play, self.slider, self._time]),
                self._key_box,
                row(self.pose_it, self.stop),
                self._about,
            ]
        )
        self.slider.observe(self._scrub, names="value")
        self.source.observe(self._choose, names="value")
        self.length.observe(self._set_length, names="value")
        self.easing.observe(self._ease, names="value")

    @property
    def over_pose(self):
        """Whether a take is on, with the pose as an offset."""
        return self.frame is not None and self.source.value != _KEYS

    @property
    def seconds(self):
        """Where the slider stands."""
        return self.slider.value / _FPS

    def set_clip(self, clip, model=None):
        """Put a clip of a model, the session's if left out, on the slider; None takes it away."""
        self.clip, self.model = clip, self.session.model if model is None else model
        self.lab.clear()
        if clip is not None:
            with quiet(self):
                self.length.max = max(self.length.max, clip.duration)
                self.length.value = max(self.length.value, clip.duration)
                self.easing.value = clip.easing
        if self.back.replaced:  # it is of the clip as it was
            self.back.forget()
        self._fit()
        self.refresh()
        if self.lab.frame is not None and self.source.value == _KEYS:
            self._leave() if clip is None else self.lab.show()

    def exchange(self, clip, name):
        """Put a clip of the session's model on the slider; the one there can be put back."""
        before = self.clip, self.model
        self.set_clip(clip)
        if before[0] is not None:
            self.back.offer(name, before, replaced=True)

    def refresh(self):
        """Show the keys, and what a take that is on means."""
        times = () if self.clip is None else self.clip.times
        remove = [["remove", "✕", "Remove this key", False]]
        self.keys.items = [
            {"id": t, "name": f"key at {t:.2f} s", "buttons": remove} for t in map(float, times)
        ]
        near = [i for i, t in enumerate(times) if abs(t - self.seconds) < 0.5 / _FPS]
        self.keys.chosen = near[0] if near else -1
        self.track.times, self.track.length = list(map(float, times)), self.length.value
        self.track.now = self.seconds
        self._key_box.layout.display = "flex" if self.source.value == _KEYS else "none"
        about = _ON_TAKE if self.source.value != _KEYS else _ON_KEYS if self.lab.frame else ""
        self._about.value = markup('<div class="facelab-status">{}</div>', about)
        self._time.value = f"{self.seconds:.2f} s"

    def toggle(self):
        """Play, or pause."""
        self.play.playing = not self.play.playing

    def halt(self):
        """Stop playing, and show none of the frames that the page has asked for already."""
        if self.play.playing:
            self.play.playing, self._halted = False, time.monotonic()
            self._pace.when_told(self._all_in)

    def take_up(self):
        """Before a drag on a frame of the clip: that frame becomes the pose."""
        if not self.over_pose:
            self._pose_frame()

    def on_screen(self):
        """A session in the pose on screen: the lab's, or for a frame that is shown one of its own.

        Raises
        ------
        ValueError
            If the frame is no pose that the model can have.
        """
        own = self.session
        if self.lab.frame is None:
            own.release()  # a drag under way is on screen, too
            return own
        shown = own.copy()
        shown.apply(self._coefficients(), self.gaze)
        return shown

    # --- callbacks --------------------------------------------------------------------------------

    def _fit(self):
        """As many steps on the slider as what it shows is long."""
        last = self.length.value
        if self.source.value != _KEYS:
            last = (len(self._track()) - 1) / self._take_fps()
        with quiet(self):
            self.play.max = self.slider.max = max(int(np.ceil(last * _FPS - 1e-6)), 1)

    def _track(self):
        """Coefficients of the take in the session's model, found once for each model."""
        name, model = self.source.value, self.session.model
        if self._tracks.get(name, (None,))[0] is not model:
            self._tracks[name] = model, self._encoded(name)
        return self._tracks[name][1]

    def _encoded(self, name):
        refused = None
        for form in self._forms(name):
            try:
                return self.session.encode(form)
            except (TypeError, ValueError) as error:
                refused = error
        raise refused

    def _forms(self, name):
        take = self.lab.takes[name]
        return take if isinstance(take, tuple) else (take,)

    def _take_fps(self):
        return self._forms(self.source.value)[0].fps

    @property
    def gaze(self):
        """Where the eyes look at the moment on the slider, (2,); with a take, as in the pose."""
        on_keys = self.source.value == _KEYS and self.clip is not None
        return self.clip.gaze_at(self.seconds) if on_keys else self.session.state.gaze

    def _coefficients(self):
        """Of the moment on the slider, shape (P,)."""
        if self.source.value == _KEYS:
            if self.clip is None:
                raise ValueError("there is no key pose yet; pose the face and press 'Key here'.")
            if self.model is not self.session.model:
                raise ValueError(OTHER_MODEL)
            return self.clip.at(self.seconds)
        track = self._track()
        now = min(round(self.seconds * self._take_fps()), len(track) - 1)
        seen = np.flatnonzero(np.isfinite(track[: now + 1]).all(axis=1))
        if not seen.size:
            raise ValueError("the take has no good frame so far; move the slider on.")
        return self.session.overlay(track[seen[-1:]])[0]

    def _all_in(self):
        self._halted = -np.inf
        self.refresh()  # the slider may have gone on

    @shows_errors
    def _scrub(self, _):
        if self.settling or time.monotonic() < self._halted + _SILENT:
            return
        self._coefficients()  # what is wrong is said before anything is shown
        self.frame = lambda: self.session.vertices_of(self._coefficients())
        self.lab.show_frame(self.frame)
        self.refresh()
        self.lab.strip.refresh()

    def _leave(self):
        self.frame = None
        self.lab.show_pose()
        self.halt()

    @shows_errors
    def _choose(self, _):
        if not self.settling:
            self._leave()
            self._fit()
            self.refresh()

    @shows_errors
    def _set_length(self, change):
        last = 0 if self.clip is None else self.clip.duration
        if not self.settling and change["new"] < last:
            with quiet(self):
                self.length.value = last
            self._choose(None)
            raise ValueError(
                f"the last key is at {last:.2f} s, and the clip is no shorter than that; move or "
                "remove the key first."
            )
        self._choose(None)

    @shows_errors
    def _ease(self, change):
        if self.clip is not None and not self.settling:
            self.set_clip(self.clip.with_easing(change["new"]), self.model)

    def _pose_frame(self):
        coefficients, gaze = self._coefficients(), self.gaze
        self._leave()
        self.session.apply(coefficients, gaze)

    @shows_errors
    def _press(self, button):
        if button is self.key:
            self._add_key()
        elif button is self.pose_it:
            self._pose_frame()
        else:
            self._leave()

    def _add_key(self):
        state = self.on_screen().state
        if self.clip is None:
            clip = Clip.of([(self.seconds, state)])
        elif self.model is not state.model:
            raise ValueError(OTHER_MODEL)
        else:
            clip = self.clip.with_key(self.seconds, state)
            if len(clip.times) == len(self.clip.times):
                self.exchange(clip, f"the key at {self.seconds:.2f} s")
                return
        self.set_clip(clip)

    def _place(self, time):
        return self.clip.times.tolist().index(time)

    @shows_errors
    def _on_track(self, do, time, seconds):
        if do == "choose":
            self.slider.value = round(time * _FPS)
            return
        i = self._place(time)
        taken = np.flatnonzero(np.abs(self.clip.times - seconds) < 0.5 / _FPS)
        if taken.size and taken[0] != i:
            self.refresh()
            raise ValueError(f"there is a key at {seconds:.2f} s already; drag it elsewhere.")
        self.set_clip(self.clip.moved_key(i, seconds), self.model)
        self.slider.value = round(seconds * _FPS)

    @shows_errors
    def _react(self, do, time):
        if do == "choose":
            self.slider.value = round(time * _FPS)
        else:
            clip, i = self.clip, self._place(time)
            of_key = ("times", "poses", "names", "gaze")
            gone = replace(clip, **{name: getattr(clip, name)[i : i + 1] for name in of_key})
            self.set_clip(clip.without_key(i) if len(clip.times) > 1 else None, self.model)
            self.back.offer(f"the key at {gone.duration:.2f} s", (gone, self.model))

    @shows_errors
    def _put_back(self):
        gone, model = self.back.gone
        if self.back.replaced:
            if model is not self.session.model:
                raise ValueError(OTHER_MODEL)
            self.exchange(gone, self.back.name)
            return
        if self.clip is None:
            clip = gone
        elif self.model is not model:
            raise ValueError(OTHER_MODEL)
        elif (np.abs(self.clip.times - gone.duration) < 0.5 / _FPS).any():
            raise ValueError(
                f"there is another key at {gone.duration:.2f} s now; drag that elsewhere first."
            )
        else:
            key = SimpleNamespace(coefficients=gone.poses[0], gaze=gone.gaze[0])
            clip = self.clip.with_key(gone.duration, key, gone.names[0])
        self.set_clip(clip, model)
        self.back.forget()
