/* Runs the instructions of a function over a block of samples side by side, one instruction after the other.

   The instructions are data, so what holds this is compiled once for all models. What stands before this defines
     CASES             for every operation its code and its loop over a block, with a and b the operands and
                       r the result
     INPUT, OUTPUT, CONSTANT   codes of what is no operation
     CHAINS            how many states are carried on side by side

   An instruction is four numbers: code, result, operands. */

#include <stdlib.h>
#include "portable.h"

typedef struct {
  int32_t code, result, first, second;
} Instruction;

typedef struct {
  int64_t length, slots; /* instructions, registers */
  const Instruction *code;
  const double *constants;
} Tape;

typedef struct {
  const double *const *in; /* arguments, sample after sample */
  const int64_t *in_stride; /* from sample to sample, zero where all samples share an argument */
  double *const *out;
  const int64_t *out_stride;
} Tables;

/* Samples `from` .. `from + count - 1`, of a block that is known when this is compiled. */
INLINE void run_block(const Tape *tape, const Tables *tables, double *registers, int64_t from, int64_t count,
                      const int block) {
  for (int64_t k = 0; k < tape->length; k++) {
    const Instruction *i = tape->code + k;
    switch (i->code) {
      case INPUT: {
        double *r = registers + (int64_t)i->result * block;
        const int64_t stride = tables->in_stride[i->first];
        const double *column = tables->in[i->first] + i->second + from * stride;
        for (int64_t l = 0; l < block; l++) r[l] = column[(l < count ? l : count - 1) * stride];
        break;
      }
      case OUTPUT: {
        const double *a = registers + (int64_t)i->first * block;
        const int64_t stride = tables->out_stride[i->result];
        double *column = tables->out[i->result] + i->second + from * stride;
        for (int64_t l = 0; l < count; l++) column[l * stride] = a[l];
        break;
      }
      case CONSTANT: {
        double *r = registers + (int64_t)i->result * block;
        for (int64_t l = 0; l < block; l++) r[l] = tape->constants[k];
        break;
      }
      default: {
        /* The result may lie where an operand was: element by element that is safe. */
        const double *a = registers + (int64_t)i->first * block, *b = registers + (int64_t)i->second * block;
        double *r = registers + (int64_t)i->result * block;
        switch (i->code) { CASES }
      }
    }
  }
}

/* --- a function at many samples ---------------------------------------------------------------------- */

#define BLOCK 64 /* samples: the registers of a large model (a thousand) stay in the second-level cache */

EXPORTED int AT_SAMPLES(int64_t samples, const Tape *tape, const double *const *in, const int64_t *in_stride,
                        double *const *out, const int64_t *out_stride);

/* Returns 1 if there is no memory. */
int AT_SAMPLES(int64_t samples, const Tape *tape, const double *const *in, const int64_t *in_stride,
               double *const *out, const int64_t *out_stride) {
  double *registers = malloc(sizeof(double) * (size_t)(tape->slots * BLOCK));
  if (!registers) return 1;
  const Tables tables = {in, in_stride, out, out_stride};
  for (int64_t from = 0; from < samples; from += BLOCK) {
    const int64_t left = samples - from;
    run_block(tape, &tables, registers, from, left < BLOCK ? left : BLOCK, BLOCK);
  }
  free(registers);
  return 0;
}

/* --- a state from step to step ----------------------------------------------------------------------- */

EXPORTED int CARRY(int64_t steps, int64_t chains, const Tape *tape, int64_t arguments, const double *const *in,
                   const int64_t *in_stride, const int64_t *in_step, double *state, int64_t size);

/* Every step takes the states of all chains, the first argument, to those after it: state is (steps + 1, chains, size),
   and of the arguments in_stride leads from chain to chain, in_step from step to step. Returns 1 if there is no memory. */
int CARRY(int64_t steps, int64_t chains, const Tape *tape, int64_t arguments, const double *const *in,
          const int64_t *in_stride, const int64_t *in_step, double *state, int64_t size) {
  double *registers = malloc(sizeof(double) * (size_t)(tape->slots * CHAINS) + sizeof(*in) * (size_t)arguments);
  if (!registers) return 1;
  const double **now = (const double **)(registers + tape->slots * CHAINS);
  for (int64_t k = 0; k < steps; k++) {
    double *after = state + (k + 1) * chains * size;
    const Tables tables = {now, in_stride, &after, &size};
    for (int64_t a = 0; a < arguments; a++) now[a] = in[a] + k * in_step[a];
    if (chains == 1) run_block(tape, &tables, registers, 0, 1, 1);
    for (int64_t from = 0; chains > 1 && from < chains; from += CHAINS)
      run_block(tape, &tables, registers, from, chains - from < CHAINS ? chains - from : CHAINS, CHAINS);
  }
  free(registers);
  return 0;
}
