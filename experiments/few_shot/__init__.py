"""Ideas for few-shot learning that turns, one file each, on the folds of `experiments.common.turning_folds`.

Figures in verdicts are joint distances from the actor in centimetres, controller / published loop, on styles that
methods were chosen on. The same method learned by another loop differs by .05 / .1: smaller differences mean nothing.
They were measured before the controller corrected its heading more gently (`TrackingConfig.correction_gain` of 4
instead of 1): figures of the controller compare with each other alone.
"""
