"""Try many hostile inputs of one kind: ``python tests/fuzzing/campaign.py --kind urdf --seed 7 --count 3000 --jobs 2``.

An input follows from the seed and its index alone: ``--seed 7 --only 123`` runs a single one again.
"""

from __future__ import annotations

import argparse
import secrets
import sys
from collections import Counter
from pathlib import Path

from tqdm import tqdm

sys.path[0] = str(Path(__file__).resolve().parent.parent)
from fuzzing import harness  # noqa: E402


def main() -> int:
    by_name = {path.stem: path for path in harness.kinds()}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0].split(":")[0])
    parser.add_argument("--kind", required=True, help=f"one of {', '.join(by_name)}, or the path of a module")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**9), help="default: a fresh one")
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--only", type=int, nargs="+", help="run these inputs alone")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="a folder for the inputs that fail, with the details")
    options = parser.parse_args()
    kind = by_name.get(options.kind, Path(options.kind))
    if not kind.is_file():
        parser.error(f"--kind: expected one of {', '.join(by_name)}, or the path of a module, got {options.kind}")
    indices = options.only or range(options.count)
    labels, failures = Counter(), []
    stopped = False
    results = harness.campaign(kind, options.seed, indices, options.jobs, options.keep)
    bar = tqdm(total=len(indices), desc=f"{kind.stem}, seed {options.seed}", unit="input", disable=None)
    try:
        for result in results:
            bar.update()
            if result.failure:
                failures.append(result)
                bar.set_postfix(failures=len(failures))
                bar.write(
                    f"seed {options.seed} index {result.index}: {result.failure}: {_gist(result, bool(options.only))}"
                )
            else:
                labels[result.label] += 1
    except KeyboardInterrupt:
        stopped = True
    finally:
        results.close()
        bar.close()
    done = labels.total() + len(failures)
    print(f"{kind.stem}, seed {options.seed}: {done} of {len(indices)} inputs{', stopped' if stopped else ''}")
    for label, count in labels.most_common():
        print(f"{count:7d} {label}")
    print(f"{len(failures):7d} failures: {dict(Counter(failure.failure for failure in failures))}")
    return 130 if stopped else int(bool(failures))


def _gist(result: harness.Result, whole: bool) -> str:
    """The line of the exception and the place it came from; ``whole``: everything."""
    if whole:
        return result.details
    lines = [line.strip() for line in result.details.split("\ncase: ")[0].splitlines() if line.strip()]
    places = [line for line in lines if line.startswith('File "') and "/pinograsp/" in line]
    return " | ".join(part[:250] for part in (*lines[-1:], *places[-1:]))


if __name__ == "__main__":
    sys.exit(main())
