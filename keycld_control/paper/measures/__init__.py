"""One measure per file: functions of a world model that return what JSON can hold."""
