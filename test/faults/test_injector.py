"""Each fault changes the pairs that it selects as described, and leaves the others unchanged."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice

import numpy as np
import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.faults import injector
from sfr_loc_map.faults.images import Affected
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import OPTIONS, Fault, FaultKind, parse_fault
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

RIG = StereoRig(64, 48, 50.0, 50.0, 31.5, 23.5, 0.1)
COUNT = 40


def pairs() -> Iterator[StereoPair]:
    rng = np.random.default_rng(0)
    for k in range(COUNT):
        left, right = rng.integers(20, 200, (2, 48, 64)).astype(np.uint8)
        yield StereoPair(k * 500_000_000, left, right)


def faulty_pairs(*texts: str, seed: int = 1) -> dict[int, StereoPair]:
    return dict(FaultInjector([parse_fault(t) for t in texts], seed, COUNT, RIG).pairs(pairs()))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "smoke",
        "black:share=2",
        "black:size=1",
        "black:share",
        "black:burst=0.5",
        "noisy:camera=up",
        "blurred:amount=1e9",
        "yaw:amount=nan",
        "scratch:amount=1",
        "focal:amount=0",
        "baseline:amount=0",
    ],
)
def test_wrong_text_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="fault"):
        parse_fault(text)


@pytest.mark.parametrize("kind", [kind for kind in FaultKind if kind.info.neutral is not None])
def test_the_neutral_amount_has_no_effect(kind: FaultKind) -> None:
    share = ",share=1,start=0" if "share" in kind.info.options else ""
    injector = FaultInjector([parse_fault(f"{kind}:amount={kind.info.neutral}{share}")], 1, COUNT, RIG)
    assert (injector.rig.fx, injector.rig.fy, injector.rig.baseline_m) == (RIG.fx, RIG.fy, RIG.baseline_m)
    changed = dict(injector.pairs(pairs()))
    for number, pair in enumerate(pairs()):
        assert changed[number].stamp_ns == pair.stamp_ns
        np.testing.assert_array_equal(changed[number].left, pair.left)
        np.testing.assert_array_equal(changed[number].right, pair.right)


@pytest.mark.parametrize("kind", [kind for kind in FaultKind if "amount" in kind.info.options])
@pytest.mark.parametrize("bound", ["min_amount", "max_amount"])
def test_each_allowed_amount_gives_pairs_or_is_refused_for_the_rig(kind: FaultKind, bound: str) -> None:
    """The plausible focal lengths and baselines depend on the rig."""
    share = ",share=1,start=0" if "share" in kind.info.options else ""
    fault = parse_fault(f"{kind}:amount={getattr(kind.info, bound)}{share}")
    with suppress(ConfigError):
        assert len(list(FaultInjector([fault], 1, 3, RIG).pairs(islice(pairs(), 3)))) == 3


@pytest.mark.parametrize("kind", ["focal", "baseline"])
def test_a_factor_that_is_impossible_for_the_rig_is_refused(kind: str) -> None:
    faults = [parse_fault(f"{kind}:amount=1000") for _ in range(2)]
    with pytest.raises(ConfigError, match=f"fault '{kind}': amount is 1000: "):
        FaultInjector(faults, 1, 3, RIG)


VALUES = {"amount": (0.2, 0.4), "share": (0.25, 0.75), "burst": (1, 7), "start": (1, 31), "camera": ("left", "right")}


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("kind", FaultKind)
def test_an_option_changes_the_fault_or_is_refused(kind: FaultKind, option: str) -> None:
    """Two values of an option give different pairs or rigs if the kind has the option."""
    low, high = (1, 2) if (kind, option) == (FaultKind.START, "amount") else VALUES[option]
    texts = [f"{kind}:{option}={value}" for value in (low, high)]
    if option not in kind.info.options:
        with pytest.raises(ConfigError, match=f"'{option}' applies to {OPTIONS[option].applies_to}, not to {kind},"):
            parse_fault(texts[0])
        return
    if option == "burst":  # a burst is observed only if some pairs are not affected
        texts = [f"{text},share=0.5" for text in texts]
    if option == "share":  # a burst must not be longer than the smaller share
        texts = [f"{text},burst=5" for text in texts]
    first, second = (FaultInjector([parse_fault(text)], 1, COUNT, RIG) for text in texts)
    assert first.rig != second.rig or digest(first) != digest(second)


def digest(injector: FaultInjector) -> list[tuple[int, int, bytes, bytes]]:
    return [(k, pair.stamp_ns, pair.left.tobytes(), pair.right.tobytes()) for k, pair in injector.pairs(pairs())]


@pytest.mark.parametrize("shift", [10, -10])
def test_late_stamps_stay_in_order_after_a_fault_of_the_clock(shift: int) -> None:
    texts = (f"clock:amount={shift}", "late:share=0.3,amount=0.9")
    stamps = [pair.stamp_ns for pair in faulty_pairs(*texts).values()]
    assert (np.diff(stamps) > 0).all()


def test_late_stamps_stay_in_order_and_clock_moves_all() -> None:
    stamps = [pair.stamp_ns for pair in faulty_pairs("late:share=1,amount=0.9").values()]
    assert (np.diff(stamps) > 0).all()
    assert stamps[1] == 999_999_999
    assert [pair.stamp_ns for pair in faulty_pairs("clock:amount=-0.1").values()][3] == 1_400_000_000


@pytest.mark.parametrize(("kind", "du", "dv"), [("yaw", 1, 0), ("pitch", 0, -1)])
def test_rotated_right_camera_moves_the_image(kind: str, du: int, dv: int) -> None:
    """A view rotated to the left or down shows the centre of the scene farther right or higher, by f tan(angle)."""
    spot = np.zeros((48, 64), np.uint8)
    spot[22:26, 30:34] = 250
    fault = parse_fault(f"{kind}:amount={np.degrees(np.arctan(5 / 50))}")
    ((_, pair),) = FaultInjector([fault], 0, 1, RIG).pairs([StereoPair(0, spot, spot)])
    v, u = np.nonzero(pair.right > 100)
    assert u.mean() - 31.5 == pytest.approx(5 * du, abs=0.3)
    assert v.mean() - 23.5 == pytest.approx(5 * dv, abs=0.3)


def test_a_drift_turns_the_right_camera_from_its_start_on() -> None:
    source, found = list(pairs()), faulty_pairs("drift:amount=20,start=10")
    changed = [not np.array_equal(found[k].right, source[k].right) for k in range(COUNT)]
    assert changed == [False] * 11 + [True] * (COUNT - 11)
    assert all(np.array_equal(found[k].left, source[k].left) for k in range(COUNT))


@pytest.mark.parametrize("kind", [FaultKind.BODY, FaultKind.BLACK, FaultKind.SHIFT])
def test_selection_drive_and_each_pair_have_different_random_numbers(
    kind: FaultKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[bytes] = []

    def record(rng: np.random.Generator) -> None:
        found.append(rng.bit_generator.seed_seq.generate_state(4).tobytes())

    def record_of_pair(at: Affected) -> StereoPair:
        record(at.pair_rng)
        drives.add(at.drive_rng.bit_generator.seed_seq.generate_state(4).tobytes())
        return at.pair

    def record_selection(_: Fault, rng: np.random.Generator, count: int) -> np.ndarray:
        record(rng)
        return np.zeros(count, int)

    drives: set[bytes] = set()
    monkeypatch.setattr(kind, "info", kind.info._replace(change=record_of_pair, drops=False))
    monkeypatch.setattr(injector, "burst_starts", record_selection)
    list(FaultInjector([parse_fault(kind)] * 2, 0, COUNT, RIG).pairs(pairs()))
    assert (len(found), len(drives)) == (2 * (1 + COUNT), 2)
    assert len({*found, *drives}) == len(found) + len(drives)


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_changes_the_affected_pairs_alone(kind: FaultKind) -> None:
    """A pair without the share of a fault is the source's own; with the fault, pair, count or rig differ."""
    has_share = "share" in kind.info.options
    injector = FaultInjector([parse_fault(f"{kind}:share=1" if has_share else kind)], 1, COUNT, RIG)
    source, found = list(pairs()), dict(injector.pairs(pairs()))
    same = injector.rig == RIG and len(found) == COUNT
    for k, pair in found.items():
        same = same and pair.stamp_ns == source[k].stamp_ns
        same = same and np.array_equal(pair.left, source[k].left) and np.array_equal(pair.right, source[k].right)
    assert not same
    if has_share:
        untouched = digest(FaultInjector([parse_fault(f"{kind}:share=0")], 1, COUNT, RIG))
        assert untouched == digest(FaultInjector([], 1, COUNT, RIG))


def constant(level: int = 120) -> list[StereoPair]:
    """Return pairs of one grey level: what a fault of the view adds is all there is to see."""
    image = np.full((48, 64), level, np.uint8)
    return [StereoPair(k, image, image) for k in range(COUNT)]


def faulty_constant(text: str) -> list[StereoPair]:
    return [pair for _, pair in FaultInjector([parse_fault(text)], 3, COUNT, RIG).pairs(constant())]


def shift_between(left: np.ndarray, right: np.ndarray, most: int) -> int:
    """Return by how many columns a patch of the left image lies farther right than in the right one."""
    columns = slice(most, 64)
    errors = [np.abs(left[:, columns] - right[:, most - d : 64 - d]).mean() for d in range(most + 1)]
    return int(np.argmin(errors))


def test_body_is_the_same_in_all_pairs_and_nearer_than_the_ground() -> None:
    found = faulty_constant("body:amount=0.25")
    left, right = (np.array([getattr(pair, side) for pair in found], float) for side in ("left", "right"))
    assert (left[:, :36] == 120).all()
    assert np.abs(left[:, 36:] - left[0, 36:]).mean() < 2.0  # noise alone
    assert left[0, 36:].std() > 10.0
    assert shift_between(left[0, 36:], right[0, 36:], 20) == round(50.0 / 6.0)


def test_object_crosses_from_left_to_right_at_one_disparity() -> None:
    found = faulty_constant("object:amount=0.2,burst=10,share=0.25")
    changed = [np.nonzero((pair.left != 120).any(axis=0))[0] for pair in found]
    present = [k for k, columns in enumerate(changed) if len(columns)]
    assert len(present) == 10
    assert np.diff(present).tolist() == [1] * 9
    centres = [changed[k].mean() for k in present]
    assert np.diff(centres[1:-1]).min() > 0.0
    assert (found[present[5]].left != 120).mean() == pytest.approx(0.2, rel=0.15)
    middle = found[present[5]]
    rows = np.nonzero((middle.left != 120).any(axis=1))[0]
    left, right = (image[rows[4] : rows[-4]].astype(float) for image in (middle.left, middle.right))
    assert abs(shift_between(left, right, 14) - 50.0 / 8.0) < 1.0


def test_torn_and_frozen_images_come_from_a_pair_before() -> None:
    source = list(pairs())
    torn = faulty_pairs("torn:share=1,amount=0.25,camera=left")[5]
    assert np.array_equal(torn.left[:36], source[5].left[:36])
    assert np.array_equal(torn.left[36:], source[4].left[36:])
    assert np.array_equal(torn.right, source[5].right)
    frozen = faulty_pairs("frozen:share=1,amount=0,camera=right,start=3")
    assert all(np.array_equal(frozen[k].right, source[2].right) for k in range(3, COUNT))
    assert all(np.array_equal(frozen[k].left, source[k].left) for k in range(COUNT))
    noise = faulty_pairs("frozen:share=1,amount=2,start=3")[9].left.astype(float) - source[2].left
    assert noise.std() == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(
    "texts",
    [
        ("late:share=0.5,amount=0.3",),
        ("clock:amount=-0.1",),
        ("dropped:share=0.3", "late:share=1,amount=0.9", "clock:amount=0.2"),
        ("clock:amount=0.2", "late:share=0.4,amount=0.9", "repeated:share=0.2", "black"),
    ],
)
def test_stamps_without_images_are_those_of_the_pairs(texts: tuple[str, ...]) -> None:
    injector = FaultInjector([parse_fault(text) for text in texts], 1, COUNT, RIG)
    stamps_ns = [pair.stamp_ns for pair in pairs()]
    found_ns = injector.stamps_ns(stamps_ns)
    assert found_ns == [pair.stamp_ns for _, pair in injector.pairs(pairs())]
    assert found_ns != stamps_ns
