"""Report of stages that remove disconnected solid from a mesh."""

from __future__ import annotations

from sppm_pipeline.method.connectivity.removal import check_removal, removal_warning
from sppm_pipeline.stage import Context


def report_removal(context: Context, share: float, islands: str, finer: str = "finer voxels") -> None:
    """Report the share of solid that a stage removes as islands, refuse as `check_removal` does, or warn."""
    context.report(removed_share=share)
    check_removal(share, islands, finer=finer)
    if warning := removal_warning(share):
        context.warn(warning)
