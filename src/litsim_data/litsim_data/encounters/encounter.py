"""Encounters as scenarios, with what people did."""

from __future__ import annotations

from dataclasses import dataclass

from litsim_data.encounters.reaction import Reaction, reaction
from litsim_sim.scenario.encounter_note import EncounterNote, Track
from litsim_sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class Encounter:
    """An encounter as a scenario.

    Attributes:
        scenario: whose log is the world in which nothing happened.
        note: what the opponent, the ego, did from which step on, and who had to react to it.
        truth: what the agent did, from step 0 to the last step of the scenario.
        opponent_truth: what the opponent did.
    """

    scenario: Scenario
    note: EncounterNote
    truth: Track
    opponent_truth: Track

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Encounter:
        """Returns the encounter that the header of the scenario's recording describes.

        Raises:
            InputError: as :meth:`EncounterNote.of_scenario`.
        """
        note = EncounterNote.of_scenario(scenario)
        return cls(scenario, note, note.truth.agent.track, note.truth.opponent.track)

    @property
    def name(self) -> str:
        """That of the scenario."""
        return self.scenario.name

    @property
    def licence(self) -> str:
        """That of the recording."""
        return self.scenario.recording.header.licence

    @property
    def sizes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lengths and widths of the boxes of agent and opponent [m]."""
        log = self.scenario.log
        rows = map(log.row, (self.note.agent, self.note.opponent))
        agent, opponent = ((float(log.length[row]), float(log.width[row])) for row in rows)
        return agent, opponent

    def reaction(self, track: Track) -> Reaction:
        """Returns what an agent that drives `track` in place of the recorded one did."""
        return reaction(self.note.kind, track, self.opponent_truth, self.note.onset_step, *self.sizes)

    @property
    def people(self) -> Reaction:
        """What the agent truly did."""
        return self.reaction(self.truth)
