"""The phone's networks: when do estimates arrive over each? 100,000 requests of 4,249 bytes over each.

    python addon_tests/bench/phone.py [--seed 0]

Milliseconds to an estimate, the share that takes longer than it takes to ask again, and the share that never arrives.
"""

from __future__ import annotations

import numpy as np
from given import given

from xihenet.phone import LINKS, arrival_frames


def main() -> None:
    seed = given(__doc__, seed=0).seed
    print(f"{'link, 4,249 bytes':<20}{'median ms':>10}{'95 %':>9}{'99 %':>9}{'late':>8}{'lost':>10}")
    for name, link in LINKS.items():
        waits_s = arrival_frames(np.zeros(100_000), 4249, link, np.random.default_rng(seed))
        median, most, nearly_all = 1e3 * np.percentile(waits_s, [50, 95, 99])
        late = np.mean((waits_s > link.resend_s) & np.isfinite(waits_s))
        print(f"{name:<20}{median:10.1f}{most:9.1f}{nearly_all:9.1f}{late:8.2%}{np.mean(np.isinf(waits_s)):10.5%}")


if __name__ == "__main__":
    main()
