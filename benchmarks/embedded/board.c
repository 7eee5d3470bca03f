/* Start of a program on a Cortex-M4, input and output by semihosting (newlib's rdimon). */
#include <stdint.h>
#include <stdlib.h>

#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88)

extern uint32_t bss_begin, bss_end, stack_top;
extern void initialise_monitor_handles(void);
extern int main(void);
void reset(void);
void fault(void);

/* Stack, reset, NMI, and faults. */
__attribute__((section(".vectors"), used)) const void *const vectors[16] = {
    &stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault, (void *)fault};

void fault(void) {
  _Exit(99);
}

void reset(void) {
  COPROCESSORS |= 0xFu << 20; /* the FPU may be used */
  __asm__ volatile("dsb\n isb");
  for (uint32_t *word = &bss_begin; word < &bss_end; word++) {
    *word = 0;
  }
  initialise_monitor_handles();
  exit(main());
}
