/* Start of a program on an emulated Cortex-M: vectors, floating point, then the C library. */
#include <stdint.h>

#define CPACR (*(volatile uint32_t *)0xE000ED88u) /* coprocessor access control */

extern uint32_t stack_top;
void _start(void);
void _init(void);
void _fini(void);
void reset(void);
void halt(void);

void _init(void) {}
void _fini(void) {}

void reset(void)
{
    CPACR |= 0xFu << 20; /* full access to the floating-point unit */
    __asm__ volatile("dsb\n\tisb");
    _start();
}

void halt(void)
{
    for (;;) {}
}

struct vectors {
    uint32_t *stack;
    void (*handlers[15])(void);
};
extern const struct vectors vectors;
__attribute__((section(".vectors"), used)) const struct vectors vectors = {
    &stack_top, {reset, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, halt}};
