/* Counts instructions and stack of each step of a law; link with -Wl,--wrap=LAW_step and -DMETERED=LAW_step.

   The SysTick timer of an emulator that counts instructions (-icount) counts them, too. How many ticks one
   takes is measured first, by a loop whose instructions are known. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define JOINED(a, b) a##b
#define NAMED(prefix, name) JOINED(prefix, name)
#define REAL NAMED(__real_, METERED)
#define WRAPPED NAMED(__wrap_, METERED)

#define CONTROL (*(volatile uint32_t *)0xE000E010u) /* of SysTick, which counts down */
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define CURRENT (*(volatile uint32_t *)0xE000E018u)
#define LARGEST 0xFFFFFFu
#define PATTERN 0xA5A5A5A5u

enum { LOOPS = 300000, CALLS = 1000, PAINTED = 32768, MARGIN = 16 }; /* words of stack */

typedef void step(const void *numbers, const void *before, const void *inputs, const void *dt, void *after,
                  void *output);
step REAL, WRAPPED;

static uint64_t ticks; /* of all steps */
static uint32_t steps, most_ticks, loop_ticks, call_ticks, stack_bytes;
static uintptr_t stack_at_call;

/* A step that does nothing; pointers to it are volatile, so that it is called. */
static void nothing(const void *numbers, const void *before, const void *inputs, const void *dt, void *after,
                    void *output)
{
    (void)numbers, (void)before, (void)inputs, (void)dt, (void)after, (void)output;
}

static uint32_t ticks_of(step *volatile called, const void *a, const void *b, const void *c, const void *d,
                         void *e, void *f)
{
    uint32_t start;
    __asm__ volatile("mov %0, sp" : "=r"(stack_at_call));
    start = CURRENT;
    called(a, b, c, d, e, f);
    return (start - CURRENT) & LARGEST;
}

/* Return the lowest word of the free stack that is painted. */
static volatile uint32_t *lowest(void *here)
{
    return (volatile uint32_t *)((uintptr_t)here & ~(uintptr_t)3) - MARGIN - PAINTED;
}

/* Fill the free stack with a pattern. */
static __attribute__((noinline)) volatile uint32_t *paint(void)
{
    volatile uint32_t here = PATTERN;
    volatile uint32_t *const low = lowest((void *)&here);
    for (uint32_t k = 0; k < PAINTED; k++) low[k] = here;
    return low;
}

/* Return how many bytes of stack the last call took: down to the first word without the pattern. */
static uint32_t taken_from(volatile uint32_t *low)
{
    uint32_t k = 0;
    while (k < PAINTED && low[k] == PATTERN) k++;
    return stack_at_call - (uintptr_t)&low[k];
}

static void report(void)
{
    fprintf(stderr, "meter: steps=%lu ticks=%llu most_ticks=%lu loop_ticks=%lu call_ticks=%lu stack=%lu\n",
            (unsigned long)steps, (unsigned long long)ticks, (unsigned long)most_ticks,
            (unsigned long)loop_ticks, (unsigned long)call_ticks, (unsigned long)stack_bytes);
}

static void begin(void)
{
    uint32_t count = LOOPS, start;
    atexit(report);
    RELOAD = LARGEST;
    CURRENT = 0;
    CONTROL = 5; /* on, by the clock of the processor, without interrupts */
    start = CURRENT;
    __asm__ volatile("1: subs %0, #1\n\tnop\n\tbne 1b" : "+r"(count) : : "cc"); /* three instructions */
    loop_ticks = (start - CURRENT) & LARGEST;
    for (int k = 0; k < CALLS; k++) call_ticks += ticks_of(nothing, 0, 0, 0, 0, 0, 0);
}

void WRAPPED(const void *numbers, const void *before, const void *inputs, const void *dt, void *after,
             void *output)
{
    volatile uint32_t *low;
    uint32_t taken, deep;
    if (steps++ == 0) begin();
    low = paint();
    taken = ticks_of(REAL, numbers, before, inputs, dt, after, output);
    deep = taken_from(low);
    ticks += taken;
    if (taken > most_ticks) most_ticks = taken;
    if (deep > stack_bytes) stack_bytes = deep;
}
