"""Base classes are loaded one family at a time."""

import subprocess
import sys


def test_a_family_is_loaded_alone():
    script = (
        "import sys; from sppm_pipeline import Sampler, options\n"
        "room = 'sppm_pipeline.method.families.'\n"
        "print(sorted(name.removeprefix(room) for name in sys.modules if name.startswith(room)))"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "['cloud', 'interiors', 'options', 'sampler', 'scattered']"
