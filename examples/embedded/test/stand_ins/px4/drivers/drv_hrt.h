// Stand-in for drivers/drv_hrt.h of PX4.
#pragma once
#include <cstdint>

typedef uint64_t hrt_abstime;
