from pinograsp.cli import main

main()
