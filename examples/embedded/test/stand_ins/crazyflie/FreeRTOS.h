/* Stand-in for FreeRTOS.h and FreeRTOSConfig.h of the Crazyflie firmware: what the example uses. */
#pragma once
#include <stdint.h>

typedef uint32_t TickType_t;
#define M2T(X) ((unsigned int)(X))
