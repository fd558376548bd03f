"""The table of the consequences of findings."""

from __future__ import annotations

from sfr_loc_map.localisation.findings import RULES, Action, Finding, Inflation, Refusal, decide


def test_each_finding_has_a_rule_and_the_first_rule_gives_the_reason() -> None:
    assert set(RULES) == set(Finding)
    order = list(RULES)
    for finding, rule in RULES.items():
        alone = decide({finding})
        assert (alone.finding, alone.reason) == (finding, rule.reason)
        assert alone.refuses == isinstance(rule, Refusal)
        for other in order[order.index(finding) :]:
            verdict = decide({other, finding})
            of_other = decide({other})
            assert (verdict.action, verdict.reason) == (alone.action, alone.reason)
            assert verdict.inflation == alone.inflation | of_other.inflation
            assert verdict.can_be_reference == (alone.can_be_reference and of_other.can_be_reference)
    refusing = [isinstance(rule, Refusal) for rule in RULES.values()]
    assert refusing == sorted(refusing, reverse=True)  # what refuses a pair comes first
    assert decide(set()) == (None, Action.ACCEPT, None, Inflation.NONE, True, True)
