"""What the calls of a method tell of it: a leak, and times that are not those that were measured."""

from sfr_loc_map.methods.method_process import LEAK_CALLS, MB, is_misstated, leak_in


def test_a_growth_over_all_calls_is_a_leak_and_a_saw_tooth_is_none() -> None:
    tooth = [90 * MB * (number % 4) for number in range(LEAK_CALLS)]
    assert not leak_in(tooth)
    assert leak_in([level + 2 * number * MB for number, level in enumerate(tooth)]).startswith("leaking")


def test_a_transfer_of_the_result_is_no_misstatement() -> None:
    assert not is_misstated(measured_s=0.9, stated_s=0.1, calls=20)  # one delayed call
    assert not is_misstated(measured_s=26.0, stated_s=16.0, calls=20)  # less than half of the calls
    assert not is_misstated(measured_s=2.0, stated_s=0.008, calls=400)  # a fast method in a long drive
    assert is_misstated(measured_s=1.6, stated_s=0.16, calls=20)
    assert is_misstated(measured_s=0.10, stated_s=3.00, calls=20)
