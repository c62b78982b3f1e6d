-- no tables
CREATE TABLE t(x);
