/* Stand-in for log.h of the Crazyflie firmware: signatures of what the example uses.

   The macros check what they are given; the firmware's fill a section of the linker. */
#pragma once
#include <stdint.h>

typedef uint16_t logVarId_t;
#define LOG_VARID_IS_VALID(varId) ((varId) != 0xffffu)
logVarId_t logGetVarId(char *group, char *name);
float logGetFloat(logVarId_t varid);

#define LOG_UINT8 uint8_t
#define LOG_UINT32 uint32_t
#define LOG_FLOAT float
#define LOG_GROUP_START(NAME) void checked_##NAME(void); void checked_##NAME(void) {
#define LOG_ADD(TYPE, NAME, ADDRESS) { const TYPE *checked_##NAME = (ADDRESS); (void)checked_##NAME; }
#define LOG_GROUP_STOP(NAME) }
