"""Encounters as scenarios, with what people did."""

from __future__ import annotations

from dataclasses import dataclass

from litsim_data.encounters.reaction import Reaction, reaction
from litsim_sim.scenario.encounter_note import EncounterKind, EncounterNote, Split, Track
from litsim_sim.scenario.scenario import Scenario

__all__ = ["Encounter", "Track"]


@dataclass(frozen=True)
class Encounter:
    """An encounter as a scenario.

    Attributes:
        name: of the scenario.
        kind: what the opponent did.
        site: where it was recorded.
        licence: of the recording.
        split: whether models may be fitted to what the agent did, or are judged by it.
        agent: id of the vehicle that had to react.
        opponent: id of the ego, to which it had to react.
        onset_step: first step at which the ego drives; the agent's record is hidden from there on.
        scenario: whose log is the world in which nothing happened.
        truth: what the agent did, from step 0 to the last step of the scenario.
        opponent_truth: what the opponent did.
    """

    name: str
    kind: EncounterKind
    site: str
    licence: str
    split: Split
    agent: int
    opponent: int
    onset_step: int
    scenario: Scenario
    truth: Track
    opponent_truth: Track

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Encounter:
        """Returns the encounter that the header of the scenario's recording describes.

        Raises:
            InputError: as :meth:`EncounterNote.of_scenario`.
        """
        note = EncounterNote.of_scenario(scenario)
        return cls(
            name=scenario.name,
            kind=note.kind,
            site=note.site,
            licence=scenario.recording.header.licence,
            split=note.split,
            agent=note.agent,
            opponent=note.opponent,
            onset_step=note.onset_step,
            scenario=scenario,
            truth=note.truth.agent.track,
            opponent_truth=note.truth.opponent.track,
        )

    def reaction(self, agent: Track, opponent: Track) -> Reaction:
        """Returns what an `agent` in place of the recorded one did, while the `opponent` drove like this."""
        return reaction(self.kind, agent, opponent, self.onset_step, self._size(self.agent), self._size(self.opponent))

    @property
    def people(self) -> Reaction:
        """What the agent truly did."""
        return self.reaction(self.truth, self.opponent_truth)

    def _size(self, vehicle: int) -> tuple[float, float]:
        """Returns the length and width [m] of a vehicle of the log."""
        log = self.scenario.log
        row = log.row(vehicle)
        return float(log.length[row]), float(log.width[row])
