from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from litsim_data.encounters.following import LANES, PAIRS, VEHICLES
from litsim_data.encounters.packaged import WINDOWS, build, made_anew, rows
from litsim_data.encounters.split import split_of
from litsim_data.encounters.table import EncounterRow, table_text
from litsim_sim.core.errors import InputError


def data(real_data: Callable[..., Path]) -> Path:
    """The folder of the data; the test is skipped if it lacks one of the files."""
    folders = {real_data(name).parents[1] for name in (PAIRS, LANES, VEHICLES, WINDOWS)}
    return folders.pop()


def test_the_table_has_encounters_of_both_splits_by_vehicle() -> None:
    table = rows()
    assert len({row.name for row in table}) == len(table) > 800
    assert all(row.split == split_of(row.site, row.period, row.agent) for row in table)
    assert {row.licence for row in table} == {"CC BY-SA"}


def test_rows_of_one_split_are_those_of_the_table() -> None:
    assert Counter(row.split for row in rows()) == {part: len(rows(part)) for part in ("tuning", "reported")}


@pytest.mark.data
def test_the_table_is_what_the_command_makes(real_data: Callable[..., Path]) -> None:
    assert table_text(made_anew(data(real_data), Counter())) == table_text(rows())


@pytest.mark.data
def test_encounters_are_built_from_their_rows(real_data: Callable[..., Path]) -> None:
    some = (*rows()[::150], rows()[-1])
    built = {encounter.name: encounter for encounter in build(some, data(real_data))}
    again = [EncounterRow.of(built[row.name], row.source, row.period) for row in some]
    assert table_text(again) == table_text(some)


@pytest.mark.data
def test_a_row_that_the_data_lack_is_named(real_data: Callable[..., Path]) -> None:
    row = replace(rows()[0], name="nowhere")
    with pytest.raises(InputError, match=r"i80_car_following_pairs.parquet: has no encounter nowhere"):
        list(build([row], data(real_data)))
