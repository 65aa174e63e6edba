// Stand-in for px4_platform_common/tasks.h of PX4: what the example uses.
#pragma once

#define SCHED_DEFAULT 1
#define SCHED_PRIORITY_DEFAULT 100

typedef int px4_task_t;
typedef int (*px4_main_t)(int argc, char *argv[]);

px4_task_t px4_task_spawn_cmd(const char *name, int scheduler, int priority, int stack_size, px4_main_t entry,
			      char *const argv[]);
