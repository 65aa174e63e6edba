/* Stand-in for usec_time.h of the Crazyflie firmware. */
#pragma once
#include <stdint.h>

uint64_t usecTimestamp(void);
