/* Stand-in for app.h of the Crazyflie firmware: signatures of what the example uses. */
#pragma once
void appMain();
