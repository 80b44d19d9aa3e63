"""Many grasps as Parquet: shards that depend on nothing but their own name, made by one core or a thousand.

A dataset is a folder::

    DIR/dataset.json          settings, versions, hands, and the list of all shards; written first
    DIR/shards/NAME.parquet   one for each object, scale, hand, task and part; whole or not at all
    DIR/log.jsonl             who made which shard in what time; the only file in which times stand

:mod:`.schema` says what stands in a shard, ``docs/dataset.md`` how to use it.
"""
