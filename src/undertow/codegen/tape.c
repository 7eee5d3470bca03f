/* Runs the instructions of a function over BLOCK samples side by side, one instruction after the other.

   The instructions are data, so what holds this is compiled once for all models. What stands before this defines
     BLOCK             samples that go through an instruction together
     CASES             for every operation its code and its loop over a block, with a and b the operands and
                       r the result
     INPUT, OUTPUT, CONSTANT   codes of what is no operation

   An instruction is four numbers: code, result, operands. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

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

/* Samples `from` .. `from + count - 1`. */
static void run_block(const Tape *tape, const Tables *tables, double *registers, int64_t from, int64_t count) {
  for (int64_t k = 0; k < tape->length; k++) {
    const Instruction *i = tape->code + k;
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
        for (int64_t l = 0; l < BLOCK; l++) r[l] = tape->constants[k];
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
