MODULE literal
  PROC main()
    VAR robtarget pLocal:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    MoveAbsJ [[-122.0054,-49.6432,51.7564,-86.6235,-32.0677,86.0174],[0,0,0,0,0,0]],v500,z10,tool0;
    MoveL [[500,-1000,1750],
           [0.5,0.5,0.5,-0.5],   ! orientation
           [0,0,0,0],
           [9E9,9E9,9E9,9E9,9E9,9E9]],v500,fine,tool0\WObj:=wobj0;
    MoveL [[500,-1000,2750],[0.5,0.5,0.5,-0.5],config,extax],speed,fine,tool0;
    MoveC [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],[[4,5,6],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z10,tool0;
    MoveL [[xPos,-1000,2750],[0.5,0.5,0.5,-0.5],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,fine,tool0;
    pLocal.trans.z := pLocal.trans.z + 10;
    MoveL pLocal,v100,fine,tool0;
  ENDPROC
  PROC other()
    VAR robtarget pLocal:=[[7,8,9],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    MoveJ \Conc, pLocal,v100,fine,tool0;
  ENDPROC
ENDMODULE
