"""Limits of the disconnected solid that is removed without being asked for."""

from __future__ import annotations

from typing import Any

from sppm_pipeline.errors import DesignError

# removing a share s of the solid moves the porosity p by s (1 - p)
WARNED_REMOVAL = 0.01
"""Share of the solid from which a removal triggers a warning: at porosity 0.7 three times the tolerance of
`tune.porosity`. A factor of two changes only who is warned."""

MAX_REMOVAL = 0.10
"""Share of the solid from which a removal without `islands: remove` is refused: a porosity of 0.7 would become 0.73,
which is not what was asked for. A factor of two changes only who has to write the option."""


def check_removal(
    share: float,
    islands: str,
    porosity: tuple[float, float] | None = None,
    *,
    finer: str = "finer pixels",
    error: type[DesignError] = DesignError,
) -> None:
    """Refuse to remove a share of the solid from `MAX_REMOVAL` on, if `islands` is "auto".

    `porosity` is that of the part with and without this solid, `finer` what resolves thin walls better, and the error
    `Rejected` for a check of a draw.
    """
    if islands == "auto" and share >= MAX_REMOVAL:
        raise error(
            f"{_removal(share, porosity)}; without `islands: remove` at most {MAX_REMOVAL:.0%} are removed",
            hint=f"lower the porosity, or take {finer} if thin walls break; `islands: remove` removes it all the same, "
            "`islands: keep` keeps it",
        )


def removal_warning(share: float, porosity: tuple[float, float] | None = None) -> str | None:
    """Warning for solid that was removed, see `check_removal`; None below `WARNED_REMOVAL`."""
    if share < WARNED_REMOVAL:
        return None
    return f"{_removal(share, porosity)}; it was removed"


def report_removal(context: Any, share: float, islands: str, finer: str = "finer voxels") -> None:
    """Report to a `Context` the share of solid that is removed as islands, refuse as `check_removal` does, or warn."""
    context.report(removed_share=share)
    check_removal(share, islands, finer=finer)
    if warning := removal_warning(share):
        context.warn(warning)


def _removal(share: float, porosity: tuple[float, float] | None) -> str:
    text = f"{share:.2%} of the solid is disconnected from the rest"
    if porosity is not None:
        text += f" (porosity {porosity[0]:.4f} with it, {porosity[1]:.4f} without)"
    return text
