// Stand-in for uORB/Subscription.hpp of PX4: signatures of what the example uses.
#pragma once
#include "uORB.h"

namespace uORB
{
class Subscription
{
public:
	Subscription(const orb_metadata *meta = nullptr, uint8_t instance = 0);
	bool copy(void *dst);
};
} // namespace uORB
