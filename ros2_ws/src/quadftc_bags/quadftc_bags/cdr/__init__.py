"""Serialised ROS 2 messages (CDR): `layout` says where each field lies; the other modules read and write."""
