"""What the page says around its tables, whatever the numbers are."""

INTRODUCTION = """\
# How often the diagnosis is right

Vehicles from one to six degrees of freedom, simulated by a program that shares no code with undertow
(`benchmarks/hidden_effects`), with something hidden, with nothing hidden, or with something that no
catalogue lists. The seeds were not used while the measured program was developed (what was mended after
a failure here is said beside it, and was then measured on other seeds). Every number comes with Wilson's
95 % confidence interval, wrong answers stand in a list of their own, and this page is made by a program.
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
  begun at the true values, refitted to the same logs.
- *Ratio*: error of the refitted incomplete model over that of the told one. Strong: 3 and more; medium: 1.5
  to 3; weak: 1.1 to 1.5; below that the effect is hidden in the noise, and the cases are counted apart. For
  two effects: what the less visible of them is worth when the other is there. For what no catalogue lists:
  error of the refitted model over that of the same vehicle, commands and noise with nothing hidden.
- *Reported set*: all effects that the answer names, alone or as a set that the data cannot tell apart.
- *Named and nothing else*: the reported set is the truth. Net buoyancy and a constant heave force are the
  same equations for a vehicle without roll and pitch, and so are, in still water, water in the hull and
  added mass with the coupling Y_rdot; there, and nowhere else, either or both of them count as the truth.
- *False alarm*: an effect is named for a complete model.
- *Left out*: a dead band with a jump at its edge. The catalogue's is continuous, so that neither its name nor
  `unexplained` would be wrong.
- *Weaker than drawn*: where a vehicle ran away with an effect of the drawn size, the size was lowered in
  steps to 0.7, 0.5, 0.35 or 0.25 of it.

## How it was made

    python -m benchmarks.trust run --out one.jsonl --minutes 62
    python -m benchmarks.trust run --out two.jsonl --seed 4712 --minutes 38
    python -m benchmarks.trust report one.jsonl two.jsonl --out docs/trust.md --summary docs/results.md

The first 61 cases of the first seed had been run once on a version before, with one failure (a pair); the
change after it was made for other data (`rov-tether-drag` of docs/results.md, KVLCC2). One case more
(`heavy-rov:waves+velocity_misalignment:x1:n1:open:plain:94874400`) was cut off after 400 s on busy cores.

Each case took one process with one thread; seconds are those of the diagnosis alone, without the simulation,
with whatever else the machine did at the time.
"""
