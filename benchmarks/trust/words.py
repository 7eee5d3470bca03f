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

    python -m benchmarks.trust run --out one.jsonl --seed 811237 --rounds 3 --jobs 2
    python -m benchmarks.trust run --out one.jsonl --seed 811237 --rounds 5 --jobs 2 --kind complete
    python -m benchmarks.trust report one.jsonl --out docs/trust.md --summary docs/results.md

The seed was used once. The first 181 cases were answered by the program of commit d04e24a, the others by
e4168cd, in which the same rules decide but one (below). The first run was cut off by the clock after 299 of
its 375 cases; those left are of the second and third round, in which every effect comes again with other
vehicles and sizes. The second run holds complete models only, since that no more than one in a hundred of
them raises a false alarm takes the most cases to show.

Seconds on this page are those of a slow machine with tests and example pages running beside the cases.
Alone on its two cores, the diagnosis of the table of speeds in [results.md](results.md) (line 13 there)
takes 53 s with this program, and 55 s with the one that had taken 10 s when that table was made: the
machine is five times as slow as it was then, and the program is not.

Between d04e24a and e4168cd: a run kept aside of 25 to 35 s, shorter than any here, may show that a model
simulates worse where all its windows agree; and what is said beside the verdict was changed (parameters that
make up for something, effects that act like changed parameters, what the doctor found).

What was changed in the diagnosis after these cases, and what of them was answered anew by it:

- The one wrong name (ship:trim_offset, in the list of failures) is mended: beside an effect with many
  parameters much plainer ones are looked at again. The change can only matter where one effect with more
  than four parameters is named alone, and not by much. Of the medium and weak cases with such answers
  sixteen were answered anew (tethers, boundaries, cross-flow, memory, slosh, wind): fifteen as before,
  and that ship's by "trim_offset or constant_force", led by the truth; for the others there was no time.
- Two effects of which neither shows alone are tried as a pair. That can only matter where nothing at all
  was found: those ten cases here and five of earlier runs, thirteen of them outsiders, were answered
  anew; no pair is named for any.
- Values that the vehicle file holds fixed are tried beside the effects. In these vehicles nothing is held
  fixed but what is weighed, so nothing changes here.

A dead time of a fraction of a sample and a lag of the same length are not told apart by such data: for 12.5
ms at 20 Hz on a boat, both simulated exactly, the sums of squares over the run kept aside (12 000 readings)
differ by 2, where 15 is what tells; which of them leads such a set is chance.

No faint effect is larger than ten times its drawn size. Water in the hull reported together with added
mass, of which it is a special case, counts as named and nothing else, also with roll and pitch.

What the page said before, each time on seeds that were new then: base seeds 730029, 883311 and 440917,
commits 1e58c41 to 8e0a94b, 128 cases, the program being mended between the three: one wrong name
(tether_drag, by a cable of eleven kilometres, for square drag; mended); strong 41 of 43 first, medium 29 of
32, weak 10 of 10, pairs 6 of 6, no false alarm in 23 complete models, 9 of 9 outsiders unexplained. Of its
seven failures four are mended (the last of them, a sea bed that the run kept aside comes nearer to than the
others, by letting parameters move within their errors before what is left counts as more than noise); a
rise of the drag by 6 % at three times the noise is still missed, and twice a set of two holds the truth and
one that these data cannot tell from it. Base seeds 20261122, 50261123 and 60261124, commits d3e1e81 to
5facd27: 276 cases, none wrong; strong 71 of 74 first and 72 named alone, medium 63 of 66 both, weak 18 of
20 first and as many in the set, pairs 15 of 15, no false alarm in 69 complete models, 18 of 18 outsiders
unexplained. Before that: base seed 918273, commit b435ccf, 104 cases, one wrong name (thruster_lag for a
dead time of a quarter of a sample); base seed 862077, commit 405aa3f, 119 cases, none wrong; base seed
52711, 45 cases, none wrong; base seeds 4711 and 4712, 90 cases, none wrong.

Each case took one process with one thread; seconds are those of the diagnosis alone, without the simulation,
with whatever else the machine did at the time.
"""
