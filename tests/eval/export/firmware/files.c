/* The answers to policy files on standard input, each behind its size in four bytes; with the sanitizers on. */
#include <stdio.h>
#include <stdlib.h>

#include "landing_policy_file.h"

int main(void)
{
    uint32_t size;
    while (fread(&size, sizeof size, 1, stdin) == 1) {
        uint8_t *const bytes = malloc(size ? size : 1); /* of this size: what is read beyond is found */
        if (!bytes || fread(bytes, 1, size, stdin) != size) {
            return 1;
        }
        printf("%d\n", landing_policy_load(bytes, size, 0));
        const float input[LANDING_POLICY_INPUTS] = {0};
        float action[LANDING_POLICY_ACTIONS];
        landing_policy_infer_with(landing_policy_active(), input, action);
        free(bytes);
    }
    return 0;
}
