/* Instructions and stack of a call, where one instruction takes 1 ns of QEMU's clock (-icount shift=0). */
#ifndef MEASURE_H
#define MEASURE_H

#include <stdint.h>
#include <stdio.h>

#define SYSTICK ((volatile uint32_t *)0xE000E010) /* control, reload, value */

enum { CALLS = 100, TICK = 40 /* ns, at 25 MHz */, PAINTED = 1 << 18, PAINT = 0xA5, OWN = 64 };

static void nothing(void) {}

static uint32_t ticks(void (*call)(void)) {
  SYSTICK[1] = 0xFFFFFF;
  SYSTICK[2] = 0;
  SYSTICK[0] = 5; /* on, by the processor's clock */
  const uint32_t before = SYSTICK[2];
  for (int i = 0; i < CALLS; i++) {
    call();
  }
  return (before - SYSTICK[2]) & 0xFFFFFF;
}

/* Bytes below this function's frame that a call leaves changed. */
static uint32_t stack(void (*call)(void)) {
  volatile uint8_t *top = (uint8_t *)__builtin_frame_address(0) - OWN;
  volatile uint8_t *bottom = top - PAINTED;
  for (volatile uint8_t *byte = bottom; byte < top; byte++) {
    *byte = PAINT;
  }
  call();
  volatile uint8_t *reached = bottom;
  while ((reached < top) && (*reached == PAINT)) {
    reached++;
  }
  return (uint32_t)(top - reached) + OWN;
}

static void measure(const char *name, void (*call)(void)) {
  const uint32_t deepest = stack(call);
  const double each = (double)TICK * ((double)ticks(call) - (double)ticks(nothing)) / CALLS;
  printf("%s %.0f %lu\n", name, each, (unsigned long)deepest);
}

#endif
