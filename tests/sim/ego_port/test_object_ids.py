"""UUIDs of agents."""

import numpy as np

from litsim_sim.ego_port.object_ids import agent_of, uuids_of


def test_an_id_comes_back_from_its_uuid() -> None:
    ids = np.array([0, 7, -3, 2**62])
    uuids = uuids_of(ids)
    assert uuids.shape == (4, 16) and len({bytes(uuid) for uuid in uuids}) == 4
    assert [agent_of(bytes(uuid)) for uuid in uuids] == ids.tolist()
    assert agent_of(bytes(range(16))) is None and agent_of(b"") is None
