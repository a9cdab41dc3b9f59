/* The self test and some actions on a bare Cortex-M4F, as QEMU's board mps2-an386 has it; says what it answers. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "landing_policy.h"
#include "inputs.h"

extern uint32_t stack_top, bss_begin, bss_end;
void initialise_monitor_handles(void);

static void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* the floating-point unit on */
    __asm volatile("dsb\n isb");
    for (uint32_t *word = &bss_begin; word < &bss_end; word++) {
        *word = 0;
    }
    initialise_monitor_handles();
    printf("self test %d\n", landing_policy_self_test());
    for (unsigned k = 0; k < sizeof INPUTS / sizeof INPUTS[0]; k++) {
        float action[LANDING_POLICY_ACTIONS];
        landing_policy_infer(INPUTS[k], action);
        for (int j = 0; j < LANDING_POLICY_ACTIONS; j++) {
            uint32_t bits;
            memcpy(&bits, &action[j], sizeof bits);
            printf("action %08lx\n", (unsigned long)bits);
        }
    }
    exit(0);
}

static void hang(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const void *const VECTORS[] = {&stack_top, reset, hang, hang, hang, hang, hang};
