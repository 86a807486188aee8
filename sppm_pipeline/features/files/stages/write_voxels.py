"""``write.voxels``: a voxel image as .npy, TIFF, VTK image data, NRRD or Zarr."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Stage, Voxels, options
from sppm_pipeline.method.families.file_writer import extension_of, require_format, write_pieces

FORMATS = (".npy", ".tif", ".tiff", ".vti", ".nrrd", ".zarr")


@dataclass(frozen=True, kw_only=True)
class WriteVoxels(Stage):
    """Write a voxel image; the extension chooses the format: a NumPy array, a multi-page TIFF, VTK image data, NRRD, or
    a Zarr store.

    A .npy, .vti or .nrrd file holds uint8 phases, 0 for void, or float32 solid fractions, indexed x, y, z. A TIFF file
    has one page a layer, the lowest first, rows from the largest y down; an image of one phase has the values 0 and 255
    there, one of several phases their numbers, fractions are 32-bit reals. The size of a voxel, where the cell has one,
    is kept by all but .npy: in a TIFF file as resolutions per centimeter, and as ImageJ does. A .zarr folder, which
    ``xarray.open_zarr`` opens, holds the array `phase` or `fraction` in compressed blocks, the coordinates x, y and z
    of the centers of voxels with their unit, and the edges of a voxel in the attribute `spacing`.
    """

    name: ClassVar[str] = "write.voxels"

    path: str = options.write_path("voxels.npy", suffixes=FORMATS)

    def check_options(self) -> None:
        require_format(self, self.path, FORMATS, {})

    @property
    def rated_as(self) -> str:
        return {".tif": "write.tiff", ".nrrd": "write.npy", ".zarr": "write.tiff"}.get(
            extension_of(self.path), f"write{extension_of(self.path)}"
        )

    def run(self, context: Context, voxels: Voxels) -> None:
        """Write the file, or the folder."""
        if extension_of(self.path) == ".zarr":
            from sppm_pipeline.services.formats.zarr_store import encode

            name, unit = "fraction" if voxels.fractions else "phase", "mm" if voxels.physical else None
            about = {"long_name": "share of solid"} if voxels.fractions else {"long_name": "phase; 0 is void"}
            files = encode(voxels.values, voxels.spacing, unit, name, about)
            size = sum(write_pieces(context, f"{self.path}/{name}", [data]) for name, data in files)
        else:
            size = write_pieces(context, self.path, self._encoded(voxels))
        context.report(bytes=size, voxels=voxels.values.size)

    def _encoded(self, voxels: Voxels) -> Iterable[bytes]:
        from sppm_pipeline.services.formats import image_stack, nrrd, voxel_files, vti

        extension = extension_of(self.path)
        if extension == ".npy":
            return voxel_files.encode_npy(voxels.values)
        if extension == ".vti":
            array = "fraction" if voxels.fractions else "phase"
            return vti.encode(voxels.values, voxels.spacing, (0.0, 0.0, 0.0), array)
        spacing = voxels.spacing if voxels.physical else None
        if extension == ".nrrd":
            return nrrd.encode(voxels.values, spacing)
        several = voxels.fractions or voxels.values.max() > 1
        return [image_stack.encode_tiff(voxels.values if several else voxels.solid(), spacing)]
