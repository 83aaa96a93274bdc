from litsim_data.encounters.split import split_of


def test_split_of_is_the_documented_hash_of_site_period_and_vehicle() -> None:
    assert split_of("i80", 1600, 1) == "tuning"  # SHA-256 of i80/1600/1 begins with 8db311a4: 0.554
    assert split_of("i80", 1600, 2) == "reported"  # 5a9dec68: 0.354


def test_two_of_five_vehicles_are_reported() -> None:
    parts = [split_of("i80", 1715, vehicle) for vehicle in range(5000)]
    assert abs(parts.count("reported") / 5000 - 0.4) < 0.02


def test_vehicles_of_the_us101_windows_are_reported() -> None:
    assert {split_of("us101", 0, vehicle) for vehicle in (4, 150, 590, 720, 100_016)} == {"reported"}
    assert {split_of("us101_0750", 0, vehicle) for vehicle in (4, 150)} == {"reported"}
    assert "tuning" in {split_of("us101", 1, vehicle) for vehicle in (4, 150, 590, 720)}
