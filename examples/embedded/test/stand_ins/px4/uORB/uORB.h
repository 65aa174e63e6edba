// Stand-in for uORB/uORB.h of PX4: what the example uses.
#pragma once
#include <cstdint>

struct orb_metadata;
typedef const orb_metadata *orb_id_t;
#define ORB_ID(name) &__orb_##name
#define ORB_DECLARE(name) extern "C" const orb_metadata __orb_##name

int orb_subscribe(orb_id_t meta);
int orb_unsubscribe(int handle);
int orb_copy(orb_id_t meta, int handle, void *buffer);
