CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
INSERT INTO schema VALUES (3, '');
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
 serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
INSERT INTO topics VALUES (1, '/camera', 'sensor_msgs/msg/Image', 'cdr', '[]');
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
 timestamp INTEGER NOT NULL, data BLOB NOT NULL);
INSERT INTO messages VALUES (1, 1, 1000, x'00');
