"""Time of a step of highway-env [ms]: `python step_time.py VEHICLES STEPS` prints the mean over the steps.

A step is 0.1 s, simulated at 10 Hz, as LitSim's is; the road has five lanes, as that of LitSim's benchmark. Vehicles
drive by IDM and MOBIL, nothing is rendered or recorded. An episode that ends, because the ego has collided,
goes on with the next one.
"""

import sys
import time

import gymnasium
import highway_env  # noqa: F401 - registers its environments

WARM_UP = 3


def main() -> None:
    vehicles, steps = int(sys.argv[1]), int(sys.argv[2])
    rates = {"simulation_frequency": 10, "policy_frequency": 10, "duration": steps}
    env = gymnasium.make("highway-v0", config={"vehicles_count": vehicles - 1, "lanes_count": 5, **rates})
    env.reset(seed=0)
    idle = env.get_wrapper_attr("action_type").actions_indexes["IDLE"]
    spent = 0.0
    for step in range(WARM_UP + steps):
        begin = time.perf_counter()
        ended = env.step(idle)[2:4]
        spent += (time.perf_counter() - begin) if step >= WARM_UP else 0.0
        if any(ended):
            env.reset(seed=step)
    print(1e3 * spent / steps)


if __name__ == "__main__":
    main()
