// A module of PX4: the observer `isolating` on sensor_combined and vehicle_attitude.
//
// Its fault estimate goes out as debug_vect. A step takes some 40 kB of stack, more than a work queue has:
// so the module is a task of its own.
#pragma once

#include <drivers/drv_hrt.h>
#include <px4_platform_common/module.h>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/topics/debug_vect.h>
#include <uORB/topics/sensor_combined.h>
#include <uORB/topics/vehicle_attitude.h>

#include "isolating/isolating.h"
#include "isolating/isolating_numbers.h"

extern "C" __EXPORT int quadftc_diagnosis_main(int argc, char *argv[]);

class QuadftcDiagnosis : public ModuleBase<QuadftcDiagnosis>
{
public:
	static int task_spawn(int argc, char *argv[]);
	static QuadftcDiagnosis *instantiate(int argc, char *argv[]);
	static int custom_command(int argc, char *argv[]);
	static int print_usage(const char *reason = nullptr);

	void run() override;
	int print_status() override;

private:
	void take_sample(const sensor_combined_s &sensors);
	void diagnose(uint64_t timestamp);
	void publish(uint64_t timestamp);

	uORB::Subscription _attitude_sub{ORB_ID(vehicle_attitude)};
	uORB::Publication<debug_vect_s> _debug_pub{ORB_ID(debug_vect)};

	isolating_guarded_state _states[2] {}; // before and after a step, in turn
	isolating_observation_inputs _in{};
	isolating_guarded_output _out{};
	int _before{0};
	uint64_t _last{0}; // timestamp of the last sample [us]; 0: there was none
	unsigned _steps{0};
	unsigned _failures{0};
};
