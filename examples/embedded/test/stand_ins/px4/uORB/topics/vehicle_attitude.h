// Stand-in for what PX4 generates from msg/versioned/VehicleAttitude.msg: the fields.
#pragma once
#include <uORB/uORB.h>

struct vehicle_attitude_s {
	uint64_t timestamp;
	uint64_t timestamp_sample;
	float q[4]; // w, x, y, z: forward, right, down to north, east, down
	float delta_q_reset[4];
	uint8_t quat_reset_counter;
};
ORB_DECLARE(vehicle_attitude);
