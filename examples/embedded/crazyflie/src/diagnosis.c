/* A task of the Crazyflie's app layer: the observer `supervised` on the attitude estimate and the gyro.

   What it says is in the log group `diagnosis`. The other tasks go on as they are: nothing flies on it. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "FreeRTOS.h"
#include "task.h"

#include "app.h"
#include "log.h"
#include "usec_time.h"

#include "supervised/supervised.h"
#include "supervised/supervised_numbers.h"

#define PERIOD M2T(4)           /* between two samples */
#define LONGEST_GAP 1000000     /* us; after a longer one the observer begins anew */
#define RADIANS 0.017453293f    /* in a degree */
#define STANDARD_GRAVITY 9.80665f /* m/s^2 */

static logVarId_t attitude_ids[4], gyro_ids[3], accelerometer_ids[3];
static supervised_guarded_state states[2]; /* before and after a step, in turn */
static supervised_observation_inputs in;
static supervised_guarded_output out;
static float fault[3];   /* of the attitude estimate [deg] */
static uint8_t state[3]; /* 0 starting, 1 healthy, 2 suspect, 3 faulty, 4 recovering */
static uint32_t failures;

/* Find the log variables; false if the firmware lacks one. */
static bool find_variables(void)
{
    static char *const components[] = {"qx", "qy", "qz", "qw"}, *const axes[] = {"x", "y", "z"};
    bool found = true;
    for (size_t k = 0; k < 4; k++) {
        attitude_ids[k] = logGetVarId("stateEstimate", components[k]);
        found = found && LOG_VARID_IS_VALID(attitude_ids[k]);
    }
    for (size_t k = 0; k < 3; k++) {
        gyro_ids[k] = logGetVarId("gyro", axes[k]);
        accelerometer_ids[k] = logGetVarId("acc", axes[k]);
        found = found && LOG_VARID_IS_VALID(gyro_ids[k]) && LOG_VARID_IS_VALID(accelerometer_ids[k]);
    }
    return found;
}

/* Take a sample; the torque is not known here. */
static void take_sample(void)
{
    for (size_t k = 0; k < 4; k++) in.sample.q_xyzw[k] = logGetFloat(attitude_ids[k]);
    for (size_t k = 0; k < 3; k++) {
        in.sample.body_rate[k] = logGetFloat(gyro_ids[k]) * RADIANS;
        in.sample.specific_force[k] = logGetFloat(accelerometer_ids[k]) * STANDARD_GRAVITY;
    }
    in.sample.attitude_valid = in.sample.rate_valid = in.sample.force_valid = true;
}

/* Step the observer to the sample, which was taken at a time [us]; 0 for `last`: it is the first one. */
static void diagnose(uint64_t now, uint64_t last)
{
    static int before = 0;
    const bool begins = last == 0 || now - last > LONGEST_GAP;
    const float dt = begins ? 0.0f : 1e-6f * (float)(now - last);
    if (begins) supervised_init(&supervised_default, &in, &states[before]);
    supervised_step(&supervised_default, &states[before], &in, &dt, &states[!before], &out);
    before = !before;
    for (size_t k = 0; k < 3; k++) {
        fault[k] = out.said.fault[k] / RADIANS;
        state[k] = out.said.state[k];
    }
    failures += out.failed;
}

void appMain(void)
{
    uint64_t last = 0;
    TickType_t woken = xTaskGetTickCount();
    while (!find_variables()) vTaskDelay(M2T(1000));
    for (;;) {
        const uint64_t now = usecTimestamp();
        take_sample();
        if (now > last) diagnose(now, last);
        last = now;
        vTaskDelayUntil(&woken, PERIOD);
    }
}

LOG_GROUP_START(diagnosis)
LOG_ADD(LOG_FLOAT, roll, &fault[0])
LOG_ADD(LOG_FLOAT, pitch, &fault[1])
LOG_ADD(LOG_FLOAT, yaw, &fault[2])
LOG_ADD(LOG_UINT8, stateRoll, &state[0])
LOG_ADD(LOG_UINT8, statePitch, &state[1])
LOG_ADD(LOG_UINT8, stateYaw, &state[2])
LOG_ADD(LOG_UINT32, failures, &failures)
LOG_GROUP_STOP(diagnosis)
