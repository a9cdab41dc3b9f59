/* The firmware of the test: one line of standard input for each period, `run` and ten numbers of the estimator;
 * what the app sends, and its state, go to standard output. Lines before it may be `flying 0` or `flying 1`, and
 * `packet` with the hexadecimal bytes of a packet of the app channel, ten at most. */
#include <stdlib.h>
#include <string.h>

#include "firmware.h"

static const char *const NAMES[10] = {"x", "y", "z", "vx", "vy", "vz", "qx", "qy", "qz", "qw"};
static float estimates[10];
static uint32_t ticks;
static int flying;
static struct { uint8_t bytes[30]; size_t size; } packets[10];
static int waiting, taken;
uint8_t *param_landing(void);
void log_landing(const void *a[6]);

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

bool supervisorIsFlying(void) { return flying != 0; }

size_t appchannelReceiveDataPacket(void *buffer, size_t max_length, int timeout_ms)
{
    if (taken == waiting || timeout_ms != 0 || max_length < packets[taken].size) {
        return 0;
    }
    memcpy(buffer, packets[taken].bytes, packets[taken].size);
    return packets[taken++].size;
}

int appchannelSendDataPacket(void *data, size_t length)
{
    printf("reply ");
    for (size_t k = 0; k < length; k++) {
        printf("%02x", ((const uint8_t *)data)[k]);
    }
    printf("\n");
    return 1;
}

/* A packet of a line; one too many is lost, as in the firmware's queue. */
static void queue(const char *text)
{
    unsigned byte;
    if (waiting == 10) {
        return;
    }
    packets[waiting].size = 0;
    for (; sscanf(text, "%2x", &byte) == 1; text += 2) {
        packets[waiting].bytes[packets[waiting].size++] = (uint8_t)byte;
    }
    waiting++;
}

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
        const void *logged[6];
        log_landing(logged);
        printf("state %d\npolicy %08x\n", *(const uint8_t *)logged[0], (unsigned)*(const uint32_t *)logged[2]);
    }
    waiting = taken = 0;
    do {
        if (!fgets(line, sizeof line, stdin)) {
            exit(0);
        }
        if (strncmp(line, "packet ", 7) == 0) {
            queue(line + 7);
        } else if (strncmp(line, "flying ", 7) == 0) {
            flying = line[7] == '1';
        }
    } while (line[0] == 'p' || line[0] == 'f');
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
