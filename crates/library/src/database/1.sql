-- Version 1 of a library. `file` and the like name an object: a file in `objects`, called by the checksum of what it holds.

CREATE TABLE objects (
    name TEXT PRIMARY KEY,
    bytes INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE instruments (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;

CREATE TABLE slides (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    note TEXT NOT NULL DEFAULT '',
    first_named TEXT NOT NULL
) STRICT;

CREATE TABLE targets (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    -- The target's own id; empty for one of the first version of target files.
    content TEXT NOT NULL,
    instrument INTEGER NOT NULL REFERENCES instruments,
    slide INTEGER REFERENCES slides,
    note TEXT NOT NULL DEFAULT '',
    saved TEXT NOT NULL,
    objective TEXT NOT NULL,
    um_per_px REAL,
    width_px INTEGER NOT NULL,
    height_px INTEGER NOT NULL,
    features INTEGER NOT NULL,
    -- As JSON: how surely it is come back to, where that was foretold, and where the stage was.
    quality TEXT,
    stage TEXT NOT NULL,
    file TEXT NOT NULL REFERENCES objects,
    picture TEXT REFERENCES objects,
    -- What is wrong with its file, where that was seen when it was taken in.
    damaged TEXT,
    -- When it went into the bin.
    binned TEXT
) STRICT;
-- A target must be found again where a file system is blind to case.
CREATE UNIQUE INDEX targets_by_name ON targets (name COLLATE NOCASE) WHERE binned IS NULL;
CREATE INDEX targets_by_time ON targets (saved, id) WHERE binned IS NULL;
CREATE INDEX targets_by_slide ON targets (slide, saved, id) WHERE binned IS NULL;
CREATE INDEX targets_by_file ON targets (file);
CREATE INDEX targets_by_picture ON targets (picture);

-- Full text: any three letters that follow each other.
CREATE VIRTUAL TABLE words USING fts5 (name, note, slide, tokenize = 'trigram remove_diacritics 1');
-- What is deleted is not left in it.
INSERT INTO words (words, rank) VALUES ('secure-delete', 1);
CREATE TRIGGER target_is_new AFTER INSERT ON targets BEGIN
    INSERT INTO words (rowid, name, note, slide)
    VALUES (new.id, new.name, new.note, coalesce((SELECT name FROM slides WHERE id = new.slide), ''));
END;
CREATE TRIGGER target_is_other AFTER UPDATE OF name, note, slide ON targets BEGIN
    UPDATE words SET name = new.name, note = new.note,
        slide = coalesce((SELECT name FROM slides WHERE id = new.slide), '')
    WHERE rowid = new.id;
END;
CREATE TRIGGER target_is_gone AFTER DELETE ON targets BEGIN
    DELETE FROM words WHERE rowid = old.id;
END;
CREATE TRIGGER slide_is_renamed AFTER UPDATE OF name ON slides BEGIN
    UPDATE words SET slide = new.name WHERE rowid IN (SELECT id FROM targets WHERE slide = new.id);
END;

-- What was measured of an instrument: the newest of a kind counts. `of` is an objective, or the size of an image.
CREATE TABLE measurements (
    id INTEGER PRIMARY KEY,
    kind TEXT NOT NULL CHECK (kind IN ('calibration', 'set', 'switching', 'shadows')),
    instrument INTEGER NOT NULL REFERENCES instruments,
    of TEXT NOT NULL,
    made TEXT NOT NULL,
    file TEXT NOT NULL REFERENCES objects
) STRICT;
CREATE INDEX measurements_by_kind ON measurements (kind, of, id);
CREATE INDEX measurements_by_file ON measurements (file);

CREATE TABLE runs (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    job TEXT NOT NULL,
    instrument INTEGER NOT NULL REFERENCES instruments,
    version TEXT NOT NULL,
    began TEXT NOT NULL,
    -- Not there for one that was killed.
    ended TEXT,
    user TEXT,
    slide TEXT,
    target INTEGER REFERENCES targets ON DELETE SET NULL,
    target_name TEXT,
    verdict TEXT,
    message TEXT,
    seconds REAL,
    -- Its frames stay, whatever room they take.
    pinned INTEGER NOT NULL DEFAULT 0,
    inputs TEXT NOT NULL
) STRICT;
CREATE INDEX runs_by_target ON runs (target, id);

-- Apart from the runs, so that lists need not read over them.
CREATE TABLE answers (
    run INTEGER PRIMARY KEY REFERENCES runs ON DELETE CASCADE,
    answer TEXT NOT NULL
) STRICT;
CREATE TABLE events (
    run INTEGER NOT NULL REFERENCES runs ON DELETE CASCADE,
    number INTEGER NOT NULL,
    event TEXT NOT NULL,
    PRIMARY KEY (run, number)
) STRICT, WITHOUT ROWID;
-- Reports and the like, with the frames that are in them.
CREATE TABLE attachments (
    run INTEGER NOT NULL REFERENCES runs ON DELETE CASCADE,
    name TEXT NOT NULL,
    file TEXT NOT NULL REFERENCES objects,
    PRIMARY KEY (run, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX attachments_by_file ON attachments (file);

-- Whenever somebody went back to a target.
CREATE VIEW visits AS
SELECT id AS run, target, began, ended, user, slide, verdict, message, seconds
FROM runs WHERE job = 'reposition' AND target IS NOT NULL;

-- Every use of an object.
CREATE VIEW uses (file) AS
SELECT file FROM targets UNION ALL SELECT picture FROM targets WHERE picture IS NOT NULL
UNION ALL SELECT file FROM measurements UNION ALL SELECT file FROM attachments;

-- Files of earlier versions that are in here, by where they lay, with the object or the run that they became.
CREATE TABLE taken_in (
    path TEXT PRIMARY KEY,
    became TEXT NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX taken_in_by_object ON taken_in (became);
