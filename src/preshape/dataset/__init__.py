"""Datasets of grasps as Parquet files, for machine learning.

A dataset is a folder::

    DIR/dataset.json          settings, versions, hands, and the list of all shards; written first
    DIR/shards/NAME.parquet   one file for each object, scale, hand, task and part
    DIR/log.jsonl             for each shard its process and times; no other file contains times

A shard depends only on its name and the settings, so any number of processes makes the same files. A file is
written completely or not at all. :mod:`.schema` lists the columns; ``docs/dataset.md`` explains their use.
"""
