"""Drawing again until no check rejects."""

import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.check_porosity import CheckPorosity
from sppm_pipeline.method.stages.tune_retry import Retry
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def checked(recipe, *checks, **field):
    steps = recipe(**field)
    return recipe_of(*(step.stage for step in steps._steps), *checks)


def test_the_first_accepted_draw_is_taken(recipe):
    """Drawn by hand, every draw before the accepted one is rejected, and that one is the result."""
    steps = checked(recipe, CheckConnectivity(resolution=16, islands="reject"), level=0.08)
    context = PlainContext(2)
    made = Retry(attempts=60).run(context, steps)
    attempts = context.reported["attempts"]
    assert attempts > 1
    for attempt in range(attempts - 1):
        with pytest.raises(DesignError, match="islands"):
            steps.run(PlainContext(2, stage="stage"), attempt=attempt)
    assert steps.run(PlainContext(2), attempt=attempts - 1).digest() == made.digest()


def test_attempts_are_bounded(recipe):
    steps = checked(recipe, CheckPorosity(resolution=8, minimum=0.99))
    context = PlainContext(2)
    with pytest.raises(DesignError, match=r"none of 3 draws.*porosity"):
        Retry(attempts=3).run(context, steps)
    assert len(context.progress_calls) >= 3


def test_other_errors_are_not_swallowed(recipe):
    steps = checked(recipe, CheckConnectivity(resolution=8))
    bad = recipe_of(*(step.stage for step in steps._steps[:1]), type(steps._steps[1].stage)(count=500), *(
        step.stage for step in steps._steps[2:]
    ))  # fmt: skip
    with pytest.raises(DesignError, match="fit"):
        Retry(attempts=5).run(PlainContext(2), bad)
