"""Ideas for few-shot learning that turns, one file each, on the folds of `experiments.common.turning_folds`.

Figures in verdicts are joint distances from the actor in centimetres, controller / published loop, on styles that
methods were chosen on. The same method learned by another loop differs by .05 / .1: smaller differences mean nothing.
Unless a verdict names the present heading correction, they were measured before the controller corrected its heading
more gently and about the foot that stands: such figures of the controller compare with each other alone.
"""
