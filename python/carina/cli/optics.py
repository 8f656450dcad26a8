"""Command-line options for the optics of the airway view: scope, lens, outline, vignette, focus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carina.cli.console import print_note
from carina.errors import UsageError
from carina.render import LEAD_VIEW
from carina.scopes import OUTLINES, DepthOfField, ImageField, Lens, lens_from_file, scope_preset

CALIBRATION_SUFFIXES = (".yml", ".yaml", ".xml", ".json")


@dataclass(frozen=True, slots=True)
class OpticsOptions:
    """``--scope``, ``--lens``, ``--outline``, ``--vignette`` and ``--focus``; None where not given."""

    scope: str | None
    lens: str | None
    outline: str | None
    vignette: float | None
    focus: str | None

    def options(self, view: str) -> dict[str, Any]:
        """Return the options as keyword arguments of :func:`carina.render_view`.

        Raises
        ------
        UsageError
            If a value is invalid, or the view is not the airway view.
        VolumeImportError
            If a calibration file is invalid.
        """
        given = {name: getattr(self, name) for name in self.__slots__ if getattr(self, name) is not None}
        if given and view != LEAD_VIEW:
            raise UsageError(f"--{next(iter(given))} only applies to the airway view; found the view {view!r}")
        scope = None if self.scope in {None, "none"} else scope_preset(str(self.scope))
        if self.outline is not None and self.outline not in OUTLINES:
            raise UsageError(f"--outline: expected {', '.join(OUTLINES)}; found {self.outline!r}")
        if self.vignette is not None:
            ImageField(vignette=self.vignette)
        focus = self._focus(None if scope is None else scope.depth_of_field)
        return {
            "scope": scope,
            "lens": self._lens(),
            "outline": self.outline,
            "vignette": self.vignette,
            "depth_of_field": focus,
        }

    def _lens(self) -> Lens | None:
        if self.lens is None or self.lens in {"pinhole", "equidistant"}:
            return None if self.lens is None else Lens(self.lens)  # type: ignore[arg-type]
        if not self.lens.lower().endswith(CALIBRATION_SUFFIXES):
            raise UsageError(
                f"--lens: expected pinhole, equidistant or a calibration file ({', '.join(CALIBRATION_SUFFIXES)}); "
                f"found {self.lens!r}"
            )
        lens = lens_from_file(self.lens)
        assert lens.calibration is not None
        model = "OpenCV's fisheye model" if lens.model == "fisheye" else "OpenCV's default model"
        print_note("calibration: {}, {} x {} pixels".format(model, *lens.calibration.size_px))
        return lens

    def _focus(self, own: DepthOfField | None) -> DepthOfField | None:
        if self.focus is None:
            return None
        if self.focus == "scope":
            if own is None:
                raise UsageError("--focus scope requires --scope with a scope whose depth of field is known")
            return own
        try:
            near_mm, far_mm = (float(part) for part in self.focus.split(","))
        except ValueError:
            words = f"--focus: expected near,far in mm, such as 3,50, or scope; found {self.focus!r}"
            raise UsageError(words) from None
        return DepthOfField(near_mm, far_mm)
