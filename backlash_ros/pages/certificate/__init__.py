"""The certificate of a drive: the results of a recording on one page, for browser and printer."""
