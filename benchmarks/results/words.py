"""What docs/results.md says around its tables, whatever the numbers are."""

INTRODUCTION = """\
# Results

What undertow makes of data that it was not built on. What is true is read for these tables only; wrong
answers stay in. This page is made by a program (last section) and is not edited by hand.
"""
HIDDEN = """\
## Simulated logs with one hidden effect

Thirteen cases of an independent simulator: 3 × 100 s to identify, 100 s to validate. The vehicle files hold
exact rigid body and allocation, and guesses of added mass and damping good to 15 %. `null`: nothing is
hidden, `adequate` is right; what no catalogue has should end in `unexplained`.

"""
CSE1 = """\
## C/S Enterprise I, a model ship in a basin

Measured pose (20 Hz motion capture) and thruster set-points; velocities are derived from the pose. Vehicle
and mapping file: [examples/cse1](../examples/cse1/README.md). The towing and bollard tests of the same ship
were not used. That thrust per command is estimated was decided after a first look at these logs: held at the
value of the thesis, it left a dead band without support.

"""
CFD = """\
## A box pushed through water, by CFD

One degree of freedom, force prescribed, no noise; bundled vehicle `box-hull`. Inertia, linear and quadratic
drag do not explain these runs. Boundary elements and small oscillations give an added mass of 20.4 to 21.1
kg, to be held against X_udot below. The last table says where the model fails: starting up, coasting,
reversing. Errors of the effects added by hand are those of the force alone, under one noise model for all
of them: their scale is not that of the diagnosis.

"""
FALLING = """\
### The falling error

Effects added by hand, each model refitted, all judged on the kept-aside run under one noise model; p: chance
that so consistent a fall over the blocks of the run is luck.
"""
DRAG = """\
What is identified is the resistance of the ship under way with its propellers running. It contains the
thrust that is lost as the water streams faster through the propellers, for which the model has no effect;
on the towed hull they were presumably off. Its scale hangs on the thrust, which the logs leave wide (see
the standard errors of the slopes below). So drag that comes out larger than the towing force is no proof of
a wrong drag, and drag from these runs must not be read as towing drag.
"""
THRUST = """\
The bollard curves are not symmetric and have the wrong sign between set-points -0.2 and 0: a dead band that
is the same for all thrusters and both directions, followed by a straight line, is a rough picture of them.
The bow thruster was driven to about a third of its range in these runs, so the upper half of its table is
extrapolated. Why its thrust and that in sway lie where they do is not known; the yaw inertia, which scales
all moments, is a guess of the ship's users.
"""
DELAY = """\
The delay agrees with the one found by hand to about a tenth of a second. The identified dead band is
smaller than that of the surge bollard curve: one width stands for five thrusters, and the bow thruster
shows none.
"""
