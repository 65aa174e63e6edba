// Stand-in for px4_platform_common/posix.h of PX4: what the example uses.
#pragma once
#include <poll.h>

typedef short pollevent_t;
typedef struct {
	int fd;
	pollevent_t events;
	pollevent_t revents;
} px4_pollfd_struct_t;

int px4_poll(px4_pollfd_struct_t *fds, unsigned int nfds, int timeout);
