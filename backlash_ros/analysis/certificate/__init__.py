"""The certificate of a drive: what a recording tells of it, on one page that a browser opens and a printer prints."""
