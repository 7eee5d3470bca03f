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

    python -m benchmarks.trust run --out one.jsonl --seed 730029 --rounds 3 --jobs 2 --minutes 16
    python -m benchmarks.trust run --out two.jsonl --seed 883311 --rounds 3 --jobs 2 --minutes 31
    python -m benchmarks.trust run --out three.jsonl --seed 440917 --rounds 3 --jobs 2 --minutes 22
    python -m benchmarks.trust report one.jsonl two.jsonl three.jsonl --out docs/trust.md \\
        --summary docs/results.md

Each of the seeds was run once, and each run was cut off by the clock: the machine was half as fast as the one
before, and tests ran beside it (a diagnosis of six degrees of freedom took 16 s in the median there, and 10 s
alone on two cores, see [results.md](results.md)). The tables hold the runs as they were. What was changed
between them, after failures:

- In the first run, after 24 cases: a search without room for a disturbance is also made where the weak form
  leaves more than noise and only the simulation of windows calls it noise; the simulation still has the last
  word on what it finds.
- Between the second and the third run: a leading effect no longer puts another one out of reach that was only
  fitted roughly (that had let a cable eleven kilometres long stand for square drag, the one wrong name of the
  second run); starting points are compared within the bounds of the parameters, and there are twice as many
  for the frequency of a swinging load; late commands are simulated as they arrive, also between two samples,
  and the first second of the run kept aside judges nothing, since no log says what was commanded before it.

A dead time of a fraction of a sample and a lag of the same length are not told apart by such data: for
12.5 ms at 20 Hz on a boat, both simulated exactly, the sums of squares over the run kept aside (12 000
readings) differ by 2, where 15 is what tells; which of them leads such a set is chance.

No faint effect is larger than ten times its drawn size since this page (one had been made 1330 times as large
before). Water in the hull reported together with added mass, of which it is a special case, counts as named
and nothing else since this page, also with roll and pitch.

What the page said before was measured on base seeds 20261122, 50261123 and 60261124, commits d3e1e81 to
5facd27: 276 cases, none wrong; strong 71 of 74 first and 72 named alone, medium 63 of 66 both, weak 18 of 20
first and as many in the set, pairs 15 of 15, no false alarm in 69 complete models, 18 of 18 outsiders
unexplained. Before that: base seed 918273, commit b435ccf, 104 cases, one wrong name (thruster_lag for a dead
time of a quarter of a sample); base seed 862077, commit 405aa3f, 119 cases, none wrong; base seed 52711, 45
cases, none wrong; base seeds 4711 and 4712, 90 cases, none wrong.

Each case took one process with one thread; seconds are those of the diagnosis alone, without the simulation,
with whatever else the machine did at the time.
"""
