// Stand-in for what PX4 generates from msg/SensorCombined.msg: the fields.
#pragma once
#include <uORB/uORB.h>

struct sensor_combined_s {
	uint64_t timestamp;
	float gyro_rad[3];
	uint32_t gyro_integral_dt;
	int32_t accelerometer_timestamp_relative;
	float accelerometer_m_s2[3];
	uint32_t accelerometer_integral_dt;
	static constexpr int32_t RELATIVE_TIMESTAMP_INVALID = 2147483647;
};
ORB_DECLARE(sensor_combined);
