/* A function at many samples: its instructions run over blocks of samples.

   Compiled together with tape.c. What stands before this defines RUN, the name under which the entry point is
   exported. Everything a call needs lies in the block it allocates: calls may run in parallel. */

EXPORTED int RUN(int64_t samples, const Tape *tape, const double *const *in, const int64_t *in_stride,
                 double *const *out, const int64_t *out_stride);

/* Returns 1 if there is no memory. */
int RUN(int64_t samples, const Tape *tape, const double *const *in, const int64_t *in_stride, double *const *out,
        const int64_t *out_stride) {
  double *registers = malloc(sizeof(double) * (size_t)(tape->slots * BLOCK));
  if (!registers) return 1;
  const Tables tables = {in, in_stride, out, out_stride};
  for (int64_t from = 0; from < samples; from += BLOCK) {
    const int64_t left = samples - from;
    run_block(tape, &tables, registers, from, left < BLOCK ? left : BLOCK);
  }
  free(registers);
  return 0;
}
