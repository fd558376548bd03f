"""The command line `sfr`.

    main                    runs `app`, prints errors in one line, returns the exit code
      └─► app               the application and its groups; the record of the running command (`CommandRun`)
            └─► score, replay, ...     the command of the same name: interpret the options, call the lower layers, print

`app.PANELS` lists the commands, and states where a new command is added. A command with a source first calls
`options.announced_config`, which reads the configuration. `output.claim_outputs` then checks the outputs, and
`io.registry.open_source` opens the source; `replay` opens the source before it checks the outputs.

Shared parts of the commands are `options` (options and their values; an option without an effect is refused by
`refuse_given`), `output` (files, JSON, tables, progress), `verdict` and `issues` (output and exit codes of judgements
and of diagnoses), `live_option` (`--live`) and `former` (names of version 0.2). Everything that is not about words on
the command line is a function of a lower layer, which the Python interface and the nodes also call.
"""
