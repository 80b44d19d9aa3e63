"""Datasets of grasps as Parquet files, for machine learning.

A dataset is a folder::

    DIR/dataset.json          settings, versions, hands, and the list of all shards; written first
    DIR/shards/NAME.parquet   one file for each object, scale, hand, task and part
    DIR/log.jsonl             which process made which shard, and its times; no other file holds times

A shard depends only on its name and the settings, so one process or a thousand make the same files. A file is
written completely or not at all. :mod:`.schema` lists the columns; ``docs/dataset.md`` explains the use.
"""
