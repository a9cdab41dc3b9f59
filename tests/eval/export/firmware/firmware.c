/* The firmware of the test: one line of standard input for each period, `run` and ten numbers of the estimator;
 * what the app sends, and its state, go to standard output. */
#include <stdlib.h>
#include <string.h>

#include "firmware.h"

static const char *const NAMES[10] = {"x", "y", "z", "vx", "vy", "vz", "qx", "qy", "qz", "qw"};
static float estimates[10];
static uint32_t ticks;
uint8_t *param_landing(void);
void log_landing(const void *a[5]);

logVarId_t logGetVarId(const char *group, const char *name)
{
    for (int k = 0; k < 10 && strcmp(group, "stateEstimate") == 0; k++) {
        if (strcmp(NAMES[k], name) == 0) {
            return (logVarId_t)k;
        }
    }
    return 0xffff;
}

bool logVarIdIsValid(logVarId_t id) { return id != 0xffff; }
float logGetFloat(logVarId_t id) { return estimates[id]; }
TickType_t xTaskGetTickCount(void) { return ticks; }
uint64_t usecTimestamp(void) { return 1000u * (uint64_t)ticks; }
void commanderRelaxPriority(void) { puts("relax"); }

void commanderSetSetpoint(setpoint_t *s, int priority)
{
    printf("set %d %.9g %.9g %.9g %.9g %d %d %d %d\n", priority, (double)s->thrust, (double)s->attitude.roll,
           (double)s->attitude.pitch, (double)s->attitudeRate.yaw, (int)s->mode.roll, (int)s->mode.pitch,
           (int)s->mode.yaw, (int)(s->mode.x || s->mode.y || s->mode.z || s->mode.quat));
}

void vTaskDelayUntil(TickType_t *last, TickType_t period)
{
    static int begun;
    char line[400], *end = line;
    if (begun++) {
        const void *logged[5];
        log_landing(logged);
        printf("state %d\n", *(const uint8_t *)logged[0]);
    }
    if (!fgets(line, sizeof line, stdin)) {
        exit(0);
    }
    *param_landing() = (uint8_t)strtol(end, &end, 10);
    for (int k = 0; k < 10; k++) {
        estimates[k] = strtof(end, &end);
    }
    *last += period;
    ticks = *last;
    printf("tick %u\n", (unsigned)ticks);
}

int main(void)
{
    appMain();
    return 1;
}
