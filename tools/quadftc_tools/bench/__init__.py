"""How fast it is: latency of the graph, real-time factor in lock-step, cost of a step of each law.

Times are of the machine at hand; what carries over to others are ratios and shares.
"""
