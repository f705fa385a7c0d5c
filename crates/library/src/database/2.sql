-- Version 2: pictures that somebody brought, for a simulated microscope to look at.

CREATE TABLE pictures (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    um_per_px REAL NOT NULL,
    width_px INTEGER NOT NULL,
    height_px INTEGER NOT NULL,
    user TEXT NOT NULL,
    brought TEXT NOT NULL,
    file TEXT NOT NULL REFERENCES objects
) STRICT;
CREATE UNIQUE INDEX pictures_by_name ON pictures (name COLLATE NOCASE);
CREATE INDEX pictures_by_file ON pictures (file);

DROP VIEW uses;
CREATE VIEW uses (file) AS
SELECT file FROM targets UNION ALL SELECT picture FROM targets WHERE picture IS NOT NULL
UNION ALL SELECT file FROM measurements UNION ALL SELECT file FROM attachments
UNION ALL SELECT file FROM pictures;
