"""Research: training, the experiments of the paper, learned baselines; alone imports torch."""
