"""The performance profile: how often each algorithm is the best, and how far behind it is elsewhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from ...curves import Profile, performance_profile
from ..section import Collected, Finding, Section, figure, many, percent


class PerformanceProfile(Section):
    """Shares of the scenes within a multiple of the best, by work and by time."""

    place = 3
    title = "Performance profile"
    short = "Profile"
    template = """<div class="card">
<p>On how many of the scenes an algorithm arrives within a multiple of the best one's cost. At the left end: how often
it is the best; the name stands where it solves its last scene, with a ✕ if that is not all of them.</p>
<div class="plots two">
{% for caption, figure in figures.items() %}
<figure class="profile"><figcaption>{{ caption }}</figcaption>{{ figure }}</figure>
{% endfor %}
</div>
</div>"""

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield who is first how often, and who solved every scene."""
        for work, seconds in _profiles(collected):
            by_work, by_time = (max(one.labels, key=one.share) for one in (work, seconds))
            every = [label for label in work.labels if work.share(label, math.inf) == 1.0]
            yield Finding(
                "Over all scenes",
                f"Of {many(len(work.problems), 'scene')} {by_work} has the fewest passes on "
                f"{percent(work.share(by_work))}, {by_time} the least time on {percent(seconds.share(by_time))}. "
                f"Solved every one: {', '.join(every) or 'nobody'}.",
            )

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return both figures."""
        figures = {
            f"By {caption}": figure(profile.plot(), f"profile-{profile.by}", f"Performance profile by {profile.by}")
            for pair in _profiles(collected) for profile, caption in zip(pair, ("passes over M", "time"), strict=True)
        }
        return {"figures": figures} if figures else {}

    def files(self, collected: Collected) -> dict[str, str]:
        """Return every ratio."""
        return {f"profile_{profile.by}.csv": profile.to_csv() for pair in _profiles(collected) for profile in pair}

    def content(self, collected: Collected) -> dict[str, Any]:
        """Return every ratio."""
        return {"profiles": [profile.to_content() for pair in _profiles(collected) for profile in pair]}


def _profiles(collected: Collected) -> Iterator[tuple[Profile, Profile]]:
    """Yield the profiles by work and by seconds, where there are two scenes and one was solved."""
    reports = collected.reports()
    if len(reports) > 1 and any(curve.is_solved for report in reports for curve in report.curves):
        yield performance_profile(reports, "work"), performance_profile(reports, "seconds")
