/* The functions of FMI 3.0 around fmu.h, for model exchange and co-simulation. */
#include "fmi3Functions.h"
#include "fmu.h"

#define DONE(condition) return (condition) ? fmi3OK : fmi3Error
#define INSTANCE fmi3Instance instance
#define REFERENCES const fmi3ValueReference references[], size_t n

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(INSTANCE, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  (void)instance, (void)on, (void)n, (void)categories;
  return fmi3OK;
}

/* --- life of an instance --- */
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String given, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
  return instantiate(given);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String given, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)intermediate, (void)n;
  (void)environment, (void)log, (void)update;
  return instantiate(given);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String given, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
  (void)name, (void)given, (void)resources, (void)visible, (void)logging, (void)environment, (void)log, (void)clock;
  (void)lock, (void)unlock;
  return NULL;
}

void fmi3FreeInstance(INSTANCE) { free(instance); }

fmi3Status fmi3EnterInitializationMode(INSTANCE, fmi3Boolean defined, fmi3Float64 tolerance, fmi3Float64 from,
                                       fmi3Boolean stops, fmi3Float64 to) {
  (void)defined, (void)tolerance, (void)stops, (void)to;
  set_time(instance, from);
  return fmi3OK;
}

#define PASSED(name) \
  fmi3Status name(INSTANCE) { DONE(instance); }
PASSED(fmi3ExitInitializationMode)
PASSED(fmi3EnterEventMode)
PASSED(fmi3Terminate)
PASSED(fmi3EnterContinuousTimeMode)
PASSED(fmi3EnterStepMode)
PASSED(fmi3EvaluateDiscreteStates)
PASSED(fmi3ExitConfigurationMode)
PASSED(fmi3EnterConfigurationMode)

fmi3Status fmi3Reset(INSTANCE) {
  reset(instance);
  return fmi3OK;
}

/* --- variables --- */
fmi3Status fmi3GetFloat64(INSTANCE, REFERENCES, fmi3Float64 values[], size_t size) {
  DONE(size == n && get(instance, references, n, values));
}

fmi3Status fmi3SetFloat64(INSTANCE, REFERENCES, const fmi3Float64 values[], size_t size) {
  DONE(size == n && set(instance, references, n, values));
}

/* There are no variables of other types: asking for none of them is right. */
#define OTHER(type)                                                                         \
  fmi3Status fmi3Get##type(INSTANCE, REFERENCES, fmi3##type values[], size_t size) {        \
    (void)instance, (void)references, (void)values;                                         \
    DONE(!n && !size);                                                                      \
  }                                                                                         \
  fmi3Status fmi3Set##type(INSTANCE, REFERENCES, const fmi3##type values[], size_t size) {  \
    (void)instance, (void)references, (void)values;                                         \
    DONE(!n && !size);                                                                      \
  }
OTHER(Float32)
OTHER(Int8)
OTHER(UInt8)
OTHER(Int16)
OTHER(UInt16)
OTHER(Int32)
OTHER(UInt32)
OTHER(Int64)
OTHER(UInt64)
OTHER(Boolean)
OTHER(String)

#define NONE(name, ...)                                  \
  fmi3Status name(INSTANCE, REFERENCES, __VA_ARGS__) {   \
    (void)instance, (void)references, (void)a;           \
    DONE(!n);                                            \
  }
#define NONE_OF_TWO(name, ...)                           \
  fmi3Status name(INSTANCE, REFERENCES, __VA_ARGS__) {   \
    (void)instance, (void)references, (void)a, (void)b;  \
    DONE(!n);                                            \
  }
#define NONE_OF_THREE(name, ...)                                  \
  fmi3Status name(INSTANCE, REFERENCES, __VA_ARGS__) {            \
    (void)instance, (void)references, (void)a, (void)b, (void)c;  \
    DONE(!n);                                                     \
  }
NONE(fmi3GetClock, fmi3Clock a[])
NONE(fmi3SetClock, const fmi3Clock a[])
NONE(fmi3GetShiftDecimal, fmi3Float64 a[])
NONE(fmi3SetIntervalDecimal, const fmi3Float64 a[])
NONE(fmi3SetShiftDecimal, const fmi3Float64 a[])
NONE_OF_TWO(fmi3GetIntervalDecimal, fmi3Float64 a[], fmi3IntervalQualifier b[])
NONE_OF_TWO(fmi3GetShiftFraction, fmi3UInt64 a[], fmi3UInt64 b[])
NONE_OF_TWO(fmi3SetIntervalFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
NONE_OF_TWO(fmi3SetShiftFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
NONE_OF_THREE(fmi3GetIntervalFraction, fmi3UInt64 a[], fmi3UInt64 b[], fmi3IntervalQualifier c[])
NONE_OF_THREE(fmi3GetBinary, size_t a[], fmi3Binary b[], size_t c)
NONE_OF_THREE(fmi3SetBinary, const size_t a[], const fmi3Binary b[], size_t c)
NONE_OF_THREE(fmi3GetOutputDerivatives, const fmi3Int32 a[], fmi3Float64 b[], size_t c)

fmi3Status fmi3GetNumberOfVariableDependencies(INSTANCE, fmi3ValueReference reference, size_t *n) {
  (void)instance, (void)reference, (void)n;
  return fmi3Error; /* not announced: they stand in modelDescription.xml */
}

fmi3Status fmi3GetVariableDependencies(INSTANCE, fmi3ValueReference reference, size_t a[], fmi3ValueReference b[],
                                       size_t c[], fmi3DependencyKind kinds[], size_t n) {
  (void)instance, (void)reference, (void)a, (void)b, (void)c, (void)kinds, (void)n;
  return fmi3Error;
}

/* --- snapshots and derivatives --- */
fmi3Status fmi3GetFMUState(INSTANCE, fmi3FMUState *state) { DONE((*state = copied(instance, *state))); }

fmi3Status fmi3SetFMUState(INSTANCE, fmi3FMUState state) { DONE(state && copied(state, instance)); }

fmi3Status fmi3FreeFMUState(INSTANCE, fmi3FMUState *state) {
  (void)instance;
  free(*state);
  *state = NULL;
  return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(INSTANCE, fmi3FMUState state, size_t *size) {
  (void)instance, (void)state;
  *size = sizeof(Instance);
  return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(INSTANCE, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  (void)instance;
  DONE(size == sizeof(Instance) && memcpy(bytes, state, size));
}

fmi3Status fmi3DeserializeFMUState(INSTANCE, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  (void)instance;
  if (size == sizeof(Instance) && !*state) *state = malloc(size);
  DONE(size == sizeof(Instance) && *state && memcpy(*state, bytes, size));
}

fmi3Status fmi3GetDirectionalDerivative(INSTANCE, const fmi3ValueReference unknowns[], size_t ny,
                                        const fmi3ValueReference knowns[], size_t n, const fmi3Float64 seed[],
                                        size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities) {
  DONE(seeds == n && sensitivities == ny && derive(instance, unknowns, ny, knowns, n, seed, sensitivity));
}

fmi3Status fmi3GetAdjointDerivative(INSTANCE, const fmi3ValueReference unknowns[], size_t ny,
                                    const fmi3ValueReference knowns[], size_t n, const fmi3Float64 seed[],
                                    size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities) {
  (void)instance, (void)unknowns, (void)ny, (void)knowns, (void)n, (void)seed, (void)seeds, (void)sensitivity;
  (void)sensitivities;
  return fmi3Error;
}

/* --- model exchange --- */
fmi3Status fmi3UpdateDiscreteStates(INSTANCE, fmi3Boolean *again, fmi3Boolean *ends, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next) {
  (void)next;
  *again = *ends = *nominals = *values = *defined = fmi3False;
  DONE(instance);
}

fmi3Status fmi3CompletedIntegratorStep(INSTANCE, fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *ends) {
  (void)final;
  *event = *ends = fmi3False;
  DONE(instance);
}

fmi3Status fmi3SetTime(INSTANCE, fmi3Float64 t) {
  set_time(instance, t);
  return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(INSTANCE, const fmi3Float64 x[], size_t n) {
  if (n == NX) set_states(instance, x);
  DONE(n == NX);
}

fmi3Status fmi3GetContinuousStates(INSTANCE, fmi3Float64 x[], size_t n) {
  DONE(n == NX && memcpy(x, ((Instance *)instance)->value + X, NX * sizeof *x));
}

fmi3Status fmi3GetContinuousStateDerivatives(INSTANCE, fmi3Float64 rates[], size_t n) {
  evaluate(instance);
  DONE(n == NX && memcpy(rates, ((Instance *)instance)->value + RATE, NX * sizeof *rates));
}

fmi3Status fmi3GetNominalsOfContinuousStates(INSTANCE, fmi3Float64 nominals[], size_t n) {
  for (size_t i = 0; i < n; i++) nominals[i] = 1;
  DONE(instance && n == NX);
}

fmi3Status fmi3GetEventIndicators(INSTANCE, fmi3Float64 indicators[], size_t n) {
  (void)indicators;
  DONE(instance && !n);
}

fmi3Status fmi3GetNumberOfEventIndicators(INSTANCE, size_t *n) {
  *n = 0;
  DONE(instance);
}

fmi3Status fmi3GetNumberOfContinuousStates(INSTANCE, size_t *n) {
  *n = NX;
  DONE(instance);
}

/* --- co-simulation --- */
fmi3Status fmi3DoStep(INSTANCE, fmi3Float64 from, fmi3Float64 span, fmi3Boolean final, fmi3Boolean *event,
                      fmi3Boolean *ends, fmi3Boolean *early, fmi3Float64 *reached) {
  (void)final;
  const int fine = cover(instance, from, span);
  *event = *ends = *early = fmi3False;
  *reached = fine ? from + span : from;
  DONE(fine);
}

fmi3Status fmi3ActivateModelPartition(INSTANCE, fmi3ValueReference clock, fmi3Float64 t) {
  (void)instance, (void)clock, (void)t;
  return fmi3Error;
}
