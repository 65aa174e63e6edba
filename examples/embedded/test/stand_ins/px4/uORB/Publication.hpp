// Stand-in for uORB/Publication.hpp of PX4: signatures of what the example uses.
#pragma once
#include "uORB.h"

namespace uORB
{
template<typename T>
class Publication
{
public:
	Publication(const orb_metadata *meta);
	bool publish(const T &data);
};
} // namespace uORB
