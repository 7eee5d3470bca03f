/* Runs the instructions of a function over many samples, BLOCK samples at a time, one instruction after the other.

   The instructions are data, so this is compiled once for all models. What stands before this defines
     BLOCK             samples that go through an instruction together
     RUN               name under which the entry point is exported
     CASES             for every operation its code and its loop over a block, with a and b the operands and
                       r the result
     INPUT, OUTPUT, CONSTANT   codes of what is no operation

   An instruction is four numbers: code, result, operands. Everything a call needs lies in the block it allocates:
   calls may run in parallel. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
  int32_t code, result, first, second;
} Instruction;

typedef struct {
  const double *const *in; /* arguments, sample after sample */
  const int64_t *in_stride; /* from sample to sample, zero where all samples share an argument */
  double *const *out;
  const int64_t *out_stride;
} Tables;

/* Samples `from` .. `from + count - 1`. */
static void run_block(const Instruction *tape, int64_t length, const double *constants, const Tables *tables,
                      double *registers, int64_t from, int64_t count) {
  for (int64_t k = 0; k < length; k++) {
    const Instruction *i = tape + k;
    switch (i->code) {
      case INPUT: {
        double *r = registers + (int64_t)i->result * BLOCK;
        const int64_t stride = tables->in_stride[i->first];
        const double *column = tables->in[i->first] + i->second + from * stride;
        for (int64_t l = 0; l < BLOCK; l++) r[l] = column[(l < count ? l : count - 1) * stride];
        break;
      }
      case OUTPUT: {
        const double *a = registers + (int64_t)i->first * BLOCK;
        const int64_t stride = tables->out_stride[i->result];
        double *column = tables->out[i->result] + i->second + from * stride;
        for (int64_t l = 0; l < count; l++) column[l * stride] = a[l];
        break;
      }
      case CONSTANT: {
        double *r = registers + (int64_t)i->result * BLOCK;
        for (int64_t l = 0; l < BLOCK; l++) r[l] = constants[k];
        break;
      }
      default: {
        /* The result may lie where an operand was: element by element that is safe. */
        const double *a = registers + (int64_t)i->first * BLOCK, *b = registers + (int64_t)i->second * BLOCK;
        double *r = registers + (int64_t)i->result * BLOCK;
        switch (i->code) { CASES }
      }
    }
  }
}

EXPORTED int RUN(int64_t samples, int64_t length, const int32_t *code, const double *constants, int64_t slots,
                 const double *const *in, const int64_t *in_stride, double *const *out, const int64_t *out_stride);

/* Returns 1 if there is no memory. */
int RUN(int64_t samples, int64_t length, const int32_t *code, const double *constants, int64_t slots,
        const double *const *in, const int64_t *in_stride, double *const *out, const int64_t *out_stride) {
  double *registers = malloc(sizeof(double) * (size_t)(slots * BLOCK));
  if (!registers) return 1;
  const Tables tables = {in, in_stride, out, out_stride};
  for (int64_t from = 0; from < samples; from += BLOCK) {
    const int64_t left = samples - from;
    run_block((const Instruction *)code, length, constants, &tables, registers, from, left < BLOCK ? left : BLOCK);
  }
  free(registers);
  return 0;
}
