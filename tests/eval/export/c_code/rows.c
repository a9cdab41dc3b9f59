/* Many inputs in one call, for comparisons and clocks. */
#include "landing_policy.h"

int landing_policy_infer_rows(const float *inputs, float *actions, int rows);

int landing_policy_infer_rows(const float *inputs, float *actions, int rows)
{
    int result = LANDING_POLICY_OK;
    for (int k = 0; k < rows && result == LANDING_POLICY_OK; k++) {
        result = landing_policy_infer(inputs + k * LANDING_POLICY_INPUTS, actions + k * LANDING_POLICY_ACTIONS);
    }
    return result;
}
