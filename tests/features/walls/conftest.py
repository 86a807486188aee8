"""The tile sets of the tests of assemblies."""

from tests.method.assembly.conftest import sets as sets
