# What the module of this name loads when it is first used (`sppm_pipeline.lazily`), and type checkers read.
from sppm_pipeline.method.families.file_writer import extension_of as extension_of
from sppm_pipeline.services.formats.input_file import content_of as content_of
from sppm_pipeline.services.formats.vtu import encode_hexahedra as encode_hexahedra
