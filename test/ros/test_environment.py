"""Environment variables of a process with a ROS node; variables of the user are kept."""

from sfr_loc_map.ros import environment


def test_what_the_user_chose_stays() -> None:
    variables = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    environment.isolate(variables)
    assert variables == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    fresh: dict[str, str] = {}
    environment.isolate(fresh)
    assert fresh["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert 1 <= int(fresh["ROS_DOMAIN_ID"]) <= environment.DOMAINS


def test_two_choices_are_two_domains() -> None:
    """Replays whose process ids differ by a multiple of the number of domains must not meet."""
    chosen: list[dict[str, str]] = [{}, {}]
    for variables in chosen:
        environment.isolate(variables)
    assert chosen[0]["ROS_DOMAIN_ID"] != chosen[1]["ROS_DOMAIN_ID"]


def test_fast_dds_of_both_versions_gets_the_same_profile() -> None:
    for given, expected in (("", str(environment.PROFILE)), ("/own.xml", "/own.xml")):
        for named in environment.PROFILE_VARIABLES:
            variables = {named: given}
            environment.prepare(variables)
            assert [variables[name] for name in environment.PROFILE_VARIABLES] == [expected] * 2


def test_the_profile_of_fast_dds_is_where_the_variables_point() -> None:
    assert environment.PROFILE.is_file()
    variables: dict[str, str] = {}
    environment.prepare(variables)
    assert {variables[name] for name in environment.PROFILE_VARIABLES} == {str(environment.PROFILE)}
