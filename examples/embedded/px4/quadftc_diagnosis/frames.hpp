// From the frames of PX4 to those of quadftc: axes of the body, and of the earth.
#pragma once

namespace quadftc
{

// A vector in axes forward, right, down in axes forward, left, up.
inline void flu_from_frd(const float frd[3], float flu[3])
{
	flu[0] = frd[0];
	flu[1] = -frd[1];
	flu[2] = -frd[2];
}

// The attitude q (w, x, y, z) from forward, right, down to north, east, down as the one (x, y, z, w) from
// forward, left, up to east, north, up: (0, a, a, 0) q (0, 1, 0, 0), with a = sqrt(1/2), times -1.
inline void enu_from_ned(const float ned_wxyz[4], float enu_xyzw[4])
{
	const float a = 0.70710678f;
	const float w = ned_wxyz[0], x = ned_wxyz[1], y = ned_wxyz[2], z = ned_wxyz[3];
	enu_xyzw[0] = a * (x + y);
	enu_xyzw[1] = a * (x - y);
	enu_xyzw[2] = a * (w - z);
	enu_xyzw[3] = a * (w + z);
}

} // namespace quadftc
