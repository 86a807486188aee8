"""Promises of every stage, as suites to inherit from::

class TestMySampler(SamplerContract):
    def stages(self):
        return [MySampler(count=20), MySampler(count=1)]
"""

from __future__ import annotations

from sppm_pipeline.testing.design_contracts import ConnectorContract, SamplerContract, TilerContract
from sppm_pipeline.testing.executor_contract import ExecutorContract
from sppm_pipeline.testing.result_contracts import FieldContract, HomogenizerContract, SlicerContract, WriterContract
from sppm_pipeline.testing.stage_contract import StageContract

__all__ = [
    "ConnectorContract",
    "ExecutorContract",
    "FieldContract",
    "HomogenizerContract",
    "SamplerContract",
    "SlicerContract",
    "StageContract",
    "TilerContract",
    "WriterContract",
]
