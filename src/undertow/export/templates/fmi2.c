/* The functions of FMI 2.0 around fmu.h, for model exchange and co-simulation. */
#include "fmi2Functions.h"
#include "fmu.h"

#define DONE(condition) return (condition) ? fmi2OK : fmi2Error
#define REFERENCES const fmi2ValueReference references[], size_t n

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  (void)c, (void)on, (void)n, (void)categories;
  return fmi2OK;
}

/* --- life of an instance --- */
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String given, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
  (void)name, (void)type, (void)resources, (void)functions, (void)visible, (void)logging;
  return instantiate(given);
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real from,
                               fmi2Boolean stops, fmi2Real to) {
  (void)defined, (void)tolerance, (void)stops, (void)to;
  set_time(c, from);
  return fmi2OK;
}

#define PASSED(name) \
  fmi2Status name(fmi2Component c) { DONE(c); }
PASSED(fmi2EnterInitializationMode)
PASSED(fmi2ExitInitializationMode)
PASSED(fmi2Terminate)
PASSED(fmi2EnterEventMode)
PASSED(fmi2EnterContinuousTimeMode)

fmi2Status fmi2Reset(fmi2Component c) {
  reset(c);
  return fmi2OK;
}

/* --- variables --- */
fmi2Status fmi2GetReal(fmi2Component c, REFERENCES, fmi2Real values[]) { DONE(get(c, references, n, values)); }

fmi2Status fmi2SetReal(fmi2Component c, REFERENCES, const fmi2Real values[]) { DONE(set(c, references, n, values)); }

/* There are no variables of other types: asking for none of them is right. */
#define OTHER(type)                                                                     \
  fmi2Status fmi2Get##type(fmi2Component c, REFERENCES, fmi2##type values[]) {          \
    (void)c, (void)references, (void)values;                                            \
    DONE(!n);                                                                           \
  }                                                                                     \
  fmi2Status fmi2Set##type(fmi2Component c, REFERENCES, const fmi2##type values[]) {    \
    (void)c, (void)references, (void)values;                                            \
    DONE(!n);                                                                           \
  }
OTHER(Integer)
OTHER(Boolean)
OTHER(String)

/* --- snapshots and derivatives --- */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { DONE((*state = copied(c, *state))); }

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { DONE(state && copied(state, c)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  (void)c, (void)state;
  *size = sizeof(Instance);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  (void)c;
  DONE(size == sizeof(Instance) && memcpy(bytes, state, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  (void)c;
  if (size == sizeof(Instance) && !*state) *state = malloc(size);
  DONE(size == sizeof(Instance) && *state && memcpy(*state, bytes, size));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t ny,
                                        const fmi2ValueReference knowns[], size_t n, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
  DONE(derive(c, unknowns, ny, knowns, n, seed, sensitivity));
}

/* --- model exchange --- */
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *event) {
  memset(event, 0, sizeof *event);
  DONE(c);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final, fmi2Boolean *event, fmi2Boolean *ends) {
  (void)final;
  *event = *ends = fmi2False;
  DONE(c);
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) {
  set_time(c, t);
  return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  if (n == NX) set_states(c, x);
  DONE(n == NX);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  DONE(n == NX && memcpy(x, ((Instance *)c)->value + X, NX * sizeof *x));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real rates[], size_t n) {
  evaluate(c);
  DONE(n == NX && memcpy(rates, ((Instance *)c)->value + RATE, NX * sizeof *rates));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n) {
  for (size_t i = 0; i < n; i++) nominals[i] = 1;
  DONE(c && n == NX);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
  (void)indicators;
  DONE(c && !n);
}

/* --- co-simulation --- */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real from, fmi2Real span, fmi2Boolean final) {
  (void)final;
  DONE(cover(c, from, span));
}

fmi2Status fmi2CancelStep(fmi2Component c) {
  (void)c;
  return fmi2Error; /* steps are never pending */
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, REFERENCES, const fmi2Integer order[], const fmi2Real value[]) {
  (void)c, (void)references, (void)order, (void)value;
  DONE(!n);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, REFERENCES, const fmi2Integer order[], fmi2Real value[]) {
  (void)c, (void)references, (void)order, (void)value;
  DONE(!n);
}

#define STATUS(name, type)                                                      \
  fmi2Status name(fmi2Component c, const fmi2StatusKind kind, type *value) {    \
    (void)c, (void)kind, (void)value;                                           \
    return fmi2Discard;                                                         \
  }
STATUS(fmi2GetStatus, fmi2Status)
STATUS(fmi2GetRealStatus, fmi2Real)
STATUS(fmi2GetIntegerStatus, fmi2Integer)
STATUS(fmi2GetBooleanStatus, fmi2Boolean)
STATUS(fmi2GetStringStatus, fmi2String)
