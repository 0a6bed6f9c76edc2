//! Volumes on web servers and in buckets.
