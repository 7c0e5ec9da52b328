"""Kalibr's file of an AprilGrid."""

from pathlib import Path
from typing import Literal, Self

import cv2
from pydantic import Field, model_validator

from foundation.configuration import StrictModel, load
from vision_pc.core.perception.april_grid import AprilGrid

_TAGS = len(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11).bytesList)


class AprilGridFile(StrictModel):
    """Kalibr's ``target_type: 'aprilgrid'``: lengths in metres, the spacing in parts of a tag's side."""

    target_type: Literal["aprilgrid"]
    columns: int = Field(alias="tagCols", ge=2, le=_TAGS)
    rows: int = Field(alias="tagRows", ge=1, le=_TAGS)
    side_m: float = Field(alias="tagSize", ge=1e-3, le=2.0)
    spacing: float = Field(alias="tagSpacing", gt=0.0, le=1.0)
    first: int = Field(0, alias="codeOffset", ge=0, lt=_TAGS)

    @model_validator(mode="after")
    def _family_has_as_many(self) -> Self:
        if self.first + self.columns * self.rows > _TAGS:
            raise ValueError(
                f"tagCols x tagRows from codeOffset on: {self.first + self.columns * self.rows} tags, "
                f"tag36h11 has {_TAGS}"
            )
        return self


def read_april_grid(path: Path) -> AprilGrid:
    """The board of Kalibr's target file. Raises ConfigurationError that names key, value and limit."""
    grid = load(AprilGridFile, path)
    return AprilGrid(grid.columns, grid.rows, grid.side_m, grid.spacing, grid.first)
