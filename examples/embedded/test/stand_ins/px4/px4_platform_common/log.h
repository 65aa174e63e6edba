// Stand-in for px4_platform_common/log.h of PX4: the formats are checked.
#pragma once

__attribute__((format(printf, 1, 2))) void px4_log(const char *format, ...);
#define PX4_INFO(...) px4_log(__VA_ARGS__)
#define PX4_WARN(...) px4_log(__VA_ARGS__)
