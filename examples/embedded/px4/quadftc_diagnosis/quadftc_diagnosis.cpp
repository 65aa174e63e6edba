#include "quadftc_diagnosis.hpp"

#include <cerrno>
#include <cstring>

#include <px4_platform_common/log.h>
#include <px4_platform_common/posix.h>
#include <px4_platform_common/tasks.h>

#include "frames.hpp"

static constexpr int STACK = 45000;               // bytes
static constexpr uint64_t LONGEST_GAP = 1000000;  // us; after a longer one the observer begins anew
static constexpr uint64_t OLDEST = 50000;         // us; an attitude that is older counts as absent

int QuadftcDiagnosis::task_spawn(int argc, char *argv[])
{
	_task_id = px4_task_spawn_cmd("quadftc_diagnosis", SCHED_DEFAULT, SCHED_PRIORITY_DEFAULT, STACK,
				      (px4_main_t)&run_trampoline, (char *const *)argv);

	if (_task_id < 0) {
		_task_id = -1;
		return -errno;
	}

	return 0;
}

QuadftcDiagnosis *QuadftcDiagnosis::instantiate(int argc, char *argv[])
{
	return new QuadftcDiagnosis();
}

int QuadftcDiagnosis::custom_command(int argc, char *argv[])
{
	return print_usage("unknown command");
}

void QuadftcDiagnosis::run()
{
	const int sensors_sub = orb_subscribe(ORB_ID(sensor_combined));
	px4_pollfd_struct_t polled[1] {};
	polled[0].fd = sensors_sub;
	polled[0].events = POLLIN;

	while (!should_exit()) {
		if (px4_poll(polled, 1, 1000) > 0 && (polled[0].revents & POLLIN)) {
			sensor_combined_s sensors{};
			orb_copy(ORB_ID(sensor_combined), sensors_sub, &sensors);

			if (sensors.timestamp > _last) {
				take_sample(sensors);
				diagnose(sensors.timestamp);
				publish(sensors.timestamp);
			}
		}
	}

	orb_unsubscribe(sensors_sub);
}

// Fill in the inputs; the torque is not known here.
void QuadftcDiagnosis::take_sample(const sensor_combined_s &sensors)
{
	vehicle_attitude_s attitude{};
	const bool there = _attitude_sub.copy(&attitude) && attitude.timestamp_sample + OLDEST > sensors.timestamp;
	quadftc::enu_from_ned(attitude.q, _in.sample.q_xyzw);
	quadftc::flu_from_frd(sensors.gyro_rad, _in.sample.body_rate);
	quadftc::flu_from_frd(sensors.accelerometer_m_s2, _in.sample.specific_force);
	_in.sample.attitude_valid = there;
	_in.sample.rate_valid = true;
	_in.sample.force_valid = sensors.accelerometer_timestamp_relative != sensor_combined_s::RELATIVE_TIMESTAMP_INVALID;
}

void QuadftcDiagnosis::diagnose(uint64_t timestamp)
{
	const bool begins = _last == 0 || timestamp - _last > LONGEST_GAP;
	const float dt = begins ? 0.0f : 1e-6f * static_cast<float>(timestamp - _last);

	if (begins) {
		isolating_init(&isolating_default, &_in, &_states[_before]);
	}

	isolating_step(&isolating_default, &_states[_before], &_in, &dt, &_states[!_before], &_out);
	_before = !_before;
	_last = timestamp;
	_steps++;
	_failures += _out.failed;
}

// The fault of the attitude, roll, pitch, yaw in axes forward, left, up [rad].
void QuadftcDiagnosis::publish(uint64_t timestamp)
{
	debug_vect_s fault{};
	fault.timestamp = timestamp;
	strncpy(fault.name, "att_fault", sizeof(fault.name) - 1);
	fault.x = _out.said.fault[0];
	fault.y = _out.said.fault[1];
	fault.z = _out.said.fault[2];
	_debug_pub.publish(fault);
}

int QuadftcDiagnosis::print_status()
{
	PX4_INFO("%u steps, %u failures; states of the attitude: %d %d %d", _steps, _failures, _out.said.state[0],
		 _out.said.state[1], _out.said.state[2]);
	return 0;
}

int QuadftcDiagnosis::print_usage(const char *reason)
{
	if (reason != nullptr) {
		PX4_WARN("%s\n", reason);
	}

	PRINT_MODULE_DESCRIPTION("Tells faults of attitude, gyro and accelerometer apart.");
	PRINT_MODULE_USAGE_NAME("quadftc_diagnosis", "estimator");
	PRINT_MODULE_USAGE_COMMAND("start");
	PRINT_MODULE_USAGE_DEFAULT_COMMANDS();
	return 0;
}

int quadftc_diagnosis_main(int argc, char *argv[])
{
	return QuadftcDiagnosis::main(argc, argv);
}
