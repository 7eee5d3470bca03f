"""What the page says around its tables, whatever the numbers are."""

INTRODUCTION = """\
# How often the diagnosis is right

Vehicles from one to six degrees of freedom, simulated by a program that shares no code with undertow
(`benchmarks/hidden_effects`), with something hidden, with nothing hidden, or with something that no
catalogue lists. The seeds were not used while the measured program was developed; what was mended after a
failure is said beside it. Every number comes with Wilson's 95 % confidence interval, wrong answers stand in
a list of their own, and this page is made by a program.
"""
NO_PEERS = "Other methods were not run on these data.\n"
PEERS = """\
The other methods get the same logs and, as candidate terms, the equations of the same catalogue, as far as
these are linear in their parameters; what is not (delays, lags, dead bands, ...) they cannot express. They
have no verdict beyond the terms that they keep, so `unexplained` is not open to them.
"""
EXPRESSIBLE = """\
The same, only effects that the other methods have terms for:

"""
FAILURES = """\
Every answer that is not what it should be: a strong or medium effect that is not named alone, a weak one
that is not in the reported set, an effect claimed for a complete model, an outsider that is not called
unexplained, a pair of which one is missed, and anything that is named although the truth is hidden in the
noise and is something else. One command repeats a case with all that is known of it:

    python -m benchmarks.trust one CASE
"""
DEFINITIONS = """\
## What the words mean

- *Error*: rms of the residual of the weak form on the run kept aside, over all equations (forces and pose
  rates), in units of the noise that the sensors make.
- *Told the truth*: the model with the hidden effects added by hand, all their parameters free, the search
  begun at the true values, refitted to the same logs as the diagnosis refits what it names: weak form, then
  output error where that simulates the run kept aside no worse.
- *Ratio*: error of the refitted incomplete model (by weak form or output error, whichever is less) over that
  of the told one. Strong: 3 and more; medium: 1.5 to 3; weak: 1.1 to 1.5; below that the effect is hidden in
  the noise, and the cases are counted apart. For two effects: what the less visible of them is worth when the
  other is there. For what no catalogue lists: error of the refitted model over that of the same vehicle,
  commands and noise with nothing hidden.
- *Faint*: sizes as drawn make strong effects nearly always. So each effect comes a second time, with its size
  chosen for a ratio drawn between 1.1 and 3 (`r` in a case's name; `x` is a factor on the drawn size). The
  choice looks at the told refit, never at the diagnosis. No size is more than ten times the drawn one: a ship
  that hardly sways would need the cross-flow drag of a thousand ships.
- *Reported set*: all effects that the answer names, alone or as a set that the data cannot tell apart.
- *Named and nothing else*: the reported set is the truth. Net buoyancy and a constant heave force are the
  same equations for a vehicle without roll and pitch, and so are, in still water, water in the hull and
  added mass with the coupling Y_rdot; there, and nowhere else, either or both of them count as the truth.
  With roll and pitch, water in the hull is a special case of added mass with couplings (the same form of
  inertia matrix, the same Coriolis force): a set that holds both is what can be said, and counts.
- *False alarm*: an effect is named for a complete model.
- *Left out*: a dead band with a jump at its edge. The catalogue's is continuous, so that neither its name nor
  `unexplained` would be wrong.
- *Weaker than drawn*: where a vehicle ran away with an effect of the drawn size, the size was lowered in
  steps to 0.7, 0.5, 0.35 or 0.25 of it.

## How it was made

    python -m benchmarks.trust run --out one.jsonl --seed 20261122 --jobs 2 --minutes 31
    python -m benchmarks.trust run --out two.jsonl --seed 50261123 --jobs 2 --minutes 24
    python -m benchmarks.trust run --out three.jsonl --seed 60261124 --kind complete --rounds 14 --no-peers \\
        --jobs 2 --minutes 11
    python -m benchmarks.trust report one.jsonl two.jsonl three.jsonl --out docs/trust.md \\
        --summary docs/results.md

Each of the seeds was run once. Three things were changed between the first and the second run, after failures
of the first: a boundary is looked for in small parts of a wide range as well, a second look is taken up to a
thousand times the noise instead of thirty, and the effect that is named stands first among the candidates
(before, that was the one with the smallest error in the weak form, also where simulation decided for another:
three of the effects that do not count as ranked first were named all the same). After the second run the
plainest declaration of a set leads; the third, of complete models, is with that. Last, where more than noise
is left, simulation no longer tells models apart by gaps of a percent: on a measured roll decay it had picked
one of three effects that no log of one degree of freedom tells apart. That can only make sets larger. The
tables hold the runs as they were.

Before them, base seed 24001 served development: 24 pairs, 6 with dry friction, 90 outsiders at their size,
a fifth and a sixteenth of it. What it brought: dry friction is simulated in steps that follow it, and how
narrow it is is searched for, where the catalogue had taken 2 cm/s (six of six named, which had been missed
as often as not); what may stand for one effect of a pair is tried beside the other one (a tether hundreds
of metres long had stood for a trim error in a case of the run before); and the headline says what is
certain beside what the data cannot tell.

What the page said before was measured on base seed 918273, commit b435ccf: 104 cases, one wrong name
(thruster_lag for a dead time of a quarter of a sample); strong 30 of 30 first, 29 named alone, medium 29 of
29 first, weak 8 of 9, pairs 3 of 5, no false alarm in 19 complete models, 6 of 6 outsiders unexplained.
Before that: base seed 862077, commit 405aa3f, 119 cases, none wrong; base seed 52711, 45 cases, none wrong;
base seeds 4711 and 4712, 90 cases, none wrong.

Each case took one process with one thread; seconds are those of the diagnosis alone, without the simulation,
with whatever else the machine did at the time.
"""
