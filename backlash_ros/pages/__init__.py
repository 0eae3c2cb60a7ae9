"""Pages for people: the report of a recording, the certificate of a drive, the page that judges the paper."""
