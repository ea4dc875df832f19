"""The sliders of a posing session: components of its regions, units of its rig."""

from dataclasses import replace

import numpy as np

from facelab.checks import check_index, check_number
from facelab.looks.gaze import WIDEST, look_units, look_weights
from facelab.numeric.undo import edit
from facelab.posing.ranges import check_gaze

_FIRM = 0.02  # share of a slider's way that the pose takes: below, pins hold it
_TRIES = 3  # of `slide`: one is exact where the pose is affine


class Molding:
    """Sliders as a part of `PosingSession`."""

    @edit(over=("region", "component"))
    def mold(self, region, component, value):
        """Set a component of a region in the state that the pose holds to, c_0.

        Eq. 9 without pins: with a small beta and a large gamma the pose takes the value whole,
        otherwise the neighbours give and take. Pins keep holding.

        Parameters
        ----------
        region : int
            0 for a holistic model or a rig.
        component : int
            Of the region, strongest first; of a rig, the unit.
        value : float
            Standard deviations from the neutral (coefficients if the model knows no variances);
            of a rig, the weight, 0 to 1.

        Raises
        ------
        ValueError
            For a region, component or value out of range; nothing changes.
        """
        solver = self._solver
        s = solver.slice_of(region)
        k = s.start + check_index(component, "component", s.stop - s.start, "components")
        value = check_number(value, "value", *solver.mold_bounds)
        molded = self.state.molded.copy()
        molded[k] = value * solver.deviations[k] - self.state.c_0[k]
        return self._solved(molded=molded)

    @edit(over=("region", "component"))
    def slide(self, region, component, value):
        """Bring a component of the pose itself to a value, as far as the pins let it.

        `mold` sets the state that the pose holds to, and pins and neighbours answer; here that
        state is chosen so that the answer has the value.

        Parameters
        ----------
        region, component, value
            See `mold`.

        Raises
        ------
        ValueError
            As `mold`.
        """
        solver = self._solver
        s = solver.slice_of(region)
        k = s.start + check_index(component, "component", s.stop - s.start, "components")
        return self._slid(self.state, k, check_number(value, "value", *solver.mold_bounds))

    def _slid(self, state, k, value):
        """A state with one coefficient of its pose brought to a value, in the unit of `mold`."""
        low, high = self._solver.mold_bounds
        unit = self._solver.deviations[k]
        least, most = low * unit - state.c_0[k], high * unit - state.c_0[k]
        for _ in range(_TRIES):
            gap = value * unit - state.coefficients[k]
            if abs(gap) < 1e-9 * unit:
                break
            molded = state.molded.copy()
            molded[k] = np.clip(molded[k] + gap, least, most)
            tried = self._face.solved(state, molded=molded)
            gain = (tried.coefficients[k] - state.coefficients[k]) / gap
            if gain > _FIRM:
                molded[k] = np.clip(state.molded[k] + gap / gain, least, most)
                tried = self._face.solved(state, molded=molded)
            if abs(value * unit - tried.coefficients[k]) >= abs(gap):
                break
            state = tried
        return state

    @property
    def gaze(self):
        """Where both eyes are turned by hand or by look shapes: degrees to the left and up, (2,).

        Of look shapes of a rig, the average of both eyes.
        """
        own = np.array(self.state.gaze)
        if not self.model.named:
            return own
        turns = look_units(self._solver.names(0)).mean(axis=0)
        return own + WIDEST * (self.coefficients.clip(0, 1) @ turns)

    @edit(over=())
    def look(self, left, up):
        """Turn both eyes: by the look shapes of a rig that has some, else as part of the pose.

        Parameters
        ----------
        left, up : float
            Degrees to the person's left and up, at most 27.

        Raises
        ------
        ValueError
            For a gaze out of range; nothing changes.

        Examples
        --------
        >>> import facelab
        >>> rig = facelab.load_example().rig
        >>> session = facelab.PosingSession(rig, rig.neutral)
        >>> session.look(13.5, 0)
        >>> print(session.gaze.round(2))
        [13.5  0. ]
        """
        wanted, state = check_gaze((left, up)), self.state
        turns = look_units(self._solver.names(0)) if self.model.named else np.zeros((2, 1, 2))
        if not turns.any():
            return replace(state, gaze=wanted)
        for k, weight in zip(*look_weights(turns, wanted), strict=True):
            state = self._slid(state, k, weight)
        return replace(state, gaze=(0.0, 0.0))

    def slider_values(self, region):
        """What the pose on screen has of each component, in the unit of `mold`: shape (P_i,)."""
        s = self._solver.slice_of(region)
        return self.coefficients[s] / self._solver.deviations[s]

    def moved_by(self, region):
        """What one unit of each slider of a region moves: (P_i, n_vertices, 3), millimetres."""
        s = self._solver.slice_of(region)
        units = np.diag(self._solver.deviations)[s]
        return self.vertices_of(units) - self.vertices_of(np.zeros(units.shape[1]))

    def shares(self, region):
        """How much of the motion of a region each component holds, (P_i,), sums to 1; or None.

        None for a rig or given bases, which know no variances.
        """
        s = self._solver.slice_of(region)
        if self.plausibility() is None:
            return None
        variance = self._solver.deviations[s] ** 2
        return variance / variance.sum()

    def mold_values(self, region):
        """Where the sliders of a region stand, in the unit of `mold`: shape (P_i,)."""
        s = self._solver.slice_of(region)
        return (self.state.c_0 + self.state.molded)[s] / self._solver.deviations[s]

    def mold_ranges(self, region):
        """Sensible ends for those sliders, shape (P_i, 2): 0 to 1, or 3 standard deviations."""
        return np.tile(self._solver.mold_ends, (len(self.mold_names(region)), 1))

    def mold_names(self, region):
        """Names of those sliders: list of str."""
        return self._solver.names(region)
