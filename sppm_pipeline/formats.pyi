# What the module of this name loads when it is first used (`sppm_pipeline.lazily`), and type checkers read.
from sppm_pipeline.method.families.file_writer import extension_of as extension_of
from sppm_pipeline.method.families.file_writer import require_format as require_format
from sppm_pipeline.method.families.file_writer import write_pieces as write_pieces
from sppm_pipeline.services.formats.element_file import check_elements as check_elements
from sppm_pipeline.services.formats.element_file import read_elements as read_elements
from sppm_pipeline.services.formats.input_file import content_of as content_of
from sppm_pipeline.services.formats.vtu import encode_cells as encode_cells
