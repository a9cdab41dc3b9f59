/* The calls of the Crazyflie firmware that the app makes, for a test on this machine. Every header of the
 * firmware that the app includes is this file. */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

typedef uint16_t logVarId_t;
logVarId_t logGetVarId(const char *group, const char *name);
bool logVarIdIsValid(logVarId_t id);
float logGetFloat(logVarId_t id);

typedef enum { modeDisable = 0, modeAbs, modeVelocity } stab_mode_t;
typedef struct { stab_mode_t x, y, z, roll, pitch, yaw, quat; } setpoint_mode_t;
typedef struct { float roll, pitch, yaw; } angles_t;
typedef struct { angles_t attitude, attitudeRate; float thrust; setpoint_mode_t mode; } setpoint_t;
#define COMMANDER_PRIORITY_EXTRX 3
void commanderSetSetpoint(setpoint_t *setpoint, int priority);
void commanderRelaxPriority(void);

typedef uint32_t TickType_t;
TickType_t xTaskGetTickCount(void);
void vTaskDelayUntil(TickType_t *last, TickType_t ticks);
#define M2T(ms) ((TickType_t)(ms))
uint64_t usecTimestamp(void);
#define DEBUG_PRINT(...) printf("debug " __VA_ARGS__)
void appMain(void);

/* Where the firmware would find a parameter or a variable of the log. */
#define PARAM_UINT8
#define LOG_UINT8
#define LOG_UINT32
#define LOG_FLOAT
#define PARAM_GROUP_START(group) uint8_t *param_##group(void); uint8_t *param_##group(void) {
#define PARAM_ADD(type, name, address) return address;
#define PARAM_GROUP_STOP(group) }
#define LOG_GROUP_START(group) void log_##group(const void *a[5]); void log_##group(const void *a[5]) { int n = 0;
#define LOG_ADD(type, name, address) a[n++] = address;
#define LOG_GROUP_STOP(group) }

#endif
