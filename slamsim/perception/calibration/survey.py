"""Tags whose places are known, as data of a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.core.geometry import se3_from_se2
from slamsim.core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Of m tags: T_survey_tag (m, 4, 4) with standard deviations sigmas (m, 6), m and rad about
    the survey's axes; inf for a tag that was not surveyed. Its floor is that of the map."""

    T_survey_tag: FloatArray
    sigmas: FloatArray

    def rows(
        self, T_survey_map: FloatArray, T_map_tag: FloatArray, first: int
    ) -> tuple[FloatArray, FloatArray]:
        """(k, 6) by how many sigmas the k surveyed tags are off, and slopes (k, 6, p).

        T_survey_map: (3,), whose steps are the three values before ``first``, where those of the
        tags (m, 4, 4) begin.
        """
        known = np.flatnonzero(np.isfinite(self.sigmas).all(axis=1))
        T = se3_from_se2(T_survey_map)
        found, told = T @ T_map_tag[known], self.T_survey_tag[known]
        turn = Rotation.from_matrix(found[:, :3, :3] @ np.swapaxes(told[:, :3, :3], 1, 2))
        off = np.concatenate([found[:, :3, 3] - told[:, :3, 3], turn.as_rotvec()], axis=1)
        slopes = np.zeros((len(known), 6, first + 6 * len(T_map_tag)))
        slopes[:, 0, first - 3] = slopes[:, 1, first - 2] = slopes[:, 5, first - 1] = 1.0
        away = found[:, :2, 3] - T_survey_map[:2]
        slopes[:, 0, first - 1], slopes[:, 1, first - 1] = -away[:, 1], away[:, 0]
        for row, tag in enumerate(known.tolist()):
            for half in (0, 3):
                place = first + 6 * tag + half
                slopes[row, half : half + 3, place : place + 3] = T[:3, :3]
        sigmas = self.sigmas[known]
        return off / sigmas, slopes / sigmas[:, :, None]
