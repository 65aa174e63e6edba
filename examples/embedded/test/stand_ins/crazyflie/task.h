/* Stand-in for task.h of FreeRTOS: signatures of what the example uses. */
#pragma once
#include "FreeRTOS.h"

TickType_t xTaskGetTickCount(void);
void vTaskDelay(const TickType_t ticks);
void vTaskDelayUntil(TickType_t *const previous_wake_time, const TickType_t increment);
